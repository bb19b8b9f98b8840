//! What the tests of packages share.

use mavlink_commsec::{
    OpenError, Opened, Opener, Package, Plaintext, SealError, Sealer, SealingKey, SenderId,
};

use crate::vectors::Vector;

/// The bytes that hexadecimal digits stand for.
pub fn hex(digits: &str) -> Vec<u8> {
    base16ct::mixed::decode_vec(digits).expect("digits")
}

/// 80 bytes of message.
pub fn message(digits: &str) -> Plaintext {
    hex(digits).try_into().expect("80 bytes")
}

pub fn key(digits: &str, salt: u32) -> SealingKey {
    SealingKey::new(&hex(digits), salt).expect("a key")
}

/// Seals what `vector` says, as it says.
pub fn seal(vector: &Vector) -> Result<Package, SealError> {
    let key = key(vector.key, vector.salt);
    let mut sealer: Sealer = Sealer::resume(key, SenderId(vector.id), vector.counter);
    sealer.seal(&message(vector.plain))
}

/// A receiver that permits `ids` with one key.
pub fn receiver<const N: usize>(digits: &str, salt: u32, ids: [u32; N]) -> Opener<N> {
    let mut opener = Opener::new();
    let permitted = opener.permit(key(digits, salt), &ids.map(SenderId));
    permitted.expect("there is room");
    opener
}

/// What `opener` remembers of sender `id`.
pub fn last<const N: usize>(opener: &Opener<N>, id: u32) -> u32 {
    let mut senders = opener.senders();
    let found = senders.find(|(sender, _)| *sender == SenderId(id));
    found.expect("a permitted sender").1
}

/// Asserts that `package` is rejected with `error`, and that no sender's counter moves.
pub fn assert_rejected<const N: usize>(opener: &mut Opener<N>, package: &[u8], error: OpenError) {
    let before: Vec<_> = opener.senders().collect();
    let rejected: Result<Opened, _> = opener.open(package);
    assert_eq!(rejected.map(|opened| opened.counter()), Err(error));
    let after: Vec<_> = opener.senders().collect();
    assert_eq!(after, before, "after {error}");
}
