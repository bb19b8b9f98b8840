//! What an end remembers over a restart, each mark bound to the key that it is about.

use core::fmt;

use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;
use mavlink_commsec::{
    Cipher, CipherError, Credential, FINGERPRINT_SIZE, FIRST_COUNTER, SealingKeyError, SenderId,
};
use mavseal_store::{
    Binding, Contents, HighWaterMark, Journal, MARK_SIZE, MarkError, ProvisionError, Region,
    ReserveError,
};

/// What records are: marks of the counters that an end seals with.
pub const SENT_KIND: u8 = 0x53;
/// What records are: marks of the counters accepted of a peer.
pub const ACCEPTED_KIND: u8 = 0x41;

/// The mark of accepted counters while it is not known that all marks are stored. Nothing was accepted yet.
const BEGUN: u64 = 0;
/// The same mark afterwards.
const COMPLETE: u64 = 1;
/// The mark of the own counters of which none was used. What a cut has left of it may be read now, and not later.
const NEW: [u8; MARK_SIZE] = (FIRST_COUNTER as u64).to_le_bytes();

/// Where a mark lies: a flash, or a handle of it, and two pages in it.
pub type Place<F> = (F, Region);

/// What an end remembers over a restart: numbers above every counter that it has used or accepted.
///
/// Each mark is bound to what it is about ([`SENT_KIND`], [`ACCEPTED_KIND`]), and to the key, salt and id by their
/// [fingerprint](mavlink_commsec::SealingKey::fingerprint). So regions that are swapped, peers in another order, a mark
/// of another key, and a region that cannot be read are errors, and never a link that begins at counter 1 again.
///
/// # Provisioning
///
/// Marks are made on purpose, once in the life of a key: [`provision`](Self::provision). It stores the mark of the
/// own counters last, and then says in the others that all is stored. A power cut on the way leaves what
/// [`open`](Self::open) recognises and finishes: something is there, the own mark is not, and none of the others says
/// that it was. After more than three cuts of one mark in a row, or where other keys were in the flash before, it must
/// be asked for again.
pub struct HighWaterMarks<F, const N: usize> {
    /// Above every counter that this end has sealed with.
    pub(super) sent: HighWaterMark<F>,
    /// Above every counter that was accepted of each peer, in the order of the peers.
    pub(super) accepted: [HighWaterMark<F>; N],
    /// Of the own key, and of those of the peers.
    pub(super) fingerprints: Fingerprints<N>,
}

/// Of the own key, and of those of the peers.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Fingerprints<const N: usize> {
    own: Fingerprint,
    peers: [Fingerprint; N],
}

type Fingerprint = [u8; FINGERPRINT_SIZE];

impl<const N: usize> Fingerprints<N> {
    pub(super) fn new<C: Cipher>(
        own: &Credential,
        peers: &[Credential; N],
    ) -> Result<Self, MarksError> {
        let mut prints = [Fingerprint::default(); N];
        for (print, peer) in prints.iter_mut().zip(peers) {
            *print = fingerprint::<C>(peer)?;
        }
        Ok(Self {
            own: fingerprint::<C>(own)?,
            peers: prints,
        })
    }

    const fn sent(&self) -> Binding {
        Binding::new(SENT_KIND, self.own)
    }

    fn accepted(&self) -> [Binding; N] {
        self.peers.map(|print| Binding::new(ACCEPTED_KIND, print))
    }
}

fn fingerprint<C: Cipher>(of: &Credential) -> Result<Fingerprint, MarksError> {
    let key = of.prepare::<C>().map_err(MarksError::Key)?;
    key.fingerprint(of.id).map_err(MarksError::Cipher)
}

impl<F: NorFlash, const N: usize> HighWaterMarks<F, N> {
    /// The marks of `own` and `peers`, which [`provision`](Self::provision) has made. `C` is the cipher of the end.
    ///
    /// Nothing is written, unless the provisioning was cut: then it is finished.
    ///
    /// # Errors
    ///
    /// [`MarksError`]: there is no end to start. Nothing has changed, but for what finishing could store.
    pub fn open<C: Cipher>(
        own: &Credential,
        peers: &[Credential; N],
        sent: Place<F>,
        accepted: [Place<F>; N],
    ) -> Result<Self, MarksError> {
        let fingerprints = Fingerprints::new::<C>(own, peers)?;
        let (sent, first) = look(own.id, sent, fingerprints.sent())?;
        let mut others = [Contents::Blank; N];
        let mut found = others.iter_mut();
        let bindings = fingerprints.accepted();
        let accepted = each(peers, accepted, bindings, |id, place, binding| {
            let (place, contents) = look(id, place, binding)?;
            if let Some(other) = found.next() {
                *other = contents;
            }
            Ok(place)
        })?;
        let all_blank = others.iter().all(|other| *other == Contents::Blank);
        match first {
            Contents::Blank if all_blank => Err(MarksError::NotProvisioned),
            Contents::Blank if others.iter().all(is_unused) => {
                store(fingerprints, own.id, peers, sent, accepted)
            }
            // The own mark comes behind all others.
            Contents::Interrupted | Contents::Record(NEW) if others.iter().all(is_begun) => {
                store(fingerprints, own.id, peers, sent, accepted)
            }
            _ => find(fingerprints, own.id, peers, sent, accepted),
        }
    }

    /// Makes the marks of keys with which nothing was ever sealed or accepted. They take the place of whatever the
    /// regions hold.
    ///
    /// Only on an operator's word, or in production: keys that were in use before are taken for new ones if their
    /// marks are gone.
    ///
    /// # Errors
    ///
    /// [`MarksError::InUse`] where the flash still knows that one of these keys is in use; then, and with wrong keys,
    /// nothing has changed. [`MarksError::Provision`] and [`MarksError::Store`] where a mark could not be stored.
    pub fn provision<C: Cipher>(
        own: &Credential,
        peers: &[Credential; N],
        sent: Place<F>,
        accepted: [Place<F>; N],
    ) -> Result<Self, MarksError> {
        let fingerprints = Fingerprints::new::<C>(own, peers)?;
        // In whichever place a mark is.
        let bindings = fingerprints.accepted();
        let check = |mut place| {
            place = check_new(own.id, place, fingerprints.sent())?;
            for (peer, binding) in peers.iter().zip(bindings) {
                place = check_new(peer.id, place, binding)?;
            }
            Ok(place)
        };
        let sent = check(sent)?;
        let accepted = each(peers, accepted, bindings, |_, place, _| check(place))?;
        store(fingerprints, own.id, peers, sent, accepted)
    }
}

/// Makes the mark of one more peer, which this end has never heard, for an end whose other marks are there.
///
/// # Errors
///
/// As [`HighWaterMarks::provision`].
pub fn provision_peer<F: NorFlash, C: Cipher>(
    peer: &Credential,
    place: Place<F>,
) -> Result<(), MarksError> {
    let binding = Binding::new(ACCEPTED_KIND, fingerprint::<C>(peer)?);
    let place = check_new(peer.id, place, binding)?;
    provision(peer.id, place, binding, COMPLETE).map(drop)
}

/// What is in a region. The flash is handed back, so that all code exists for one type of it.
fn look<F: NorFlash>(
    id: SenderId,
    (flash, region): Place<F>,
    binding: Binding,
) -> Result<(Place<F>, Contents<MARK_SIZE>), MarksError> {
    let opened = Journal::open(flash, region, binding);
    let (journal, contents) = opened.map_err(|error| MarksError::Mark(id, error.into()))?;
    Ok(((journal.into_flash(), region), contents))
}

/// Whether provisioning was cut here or before.
fn is_unused(contents: &Contents<MARK_SIZE>) -> bool {
    matches!(contents, Contents::Blank | Contents::Interrupted) || is_begun(contents)
}

/// Whether provisioning was cut behind this mark.
fn is_begun(contents: &Contents<MARK_SIZE>) -> bool {
    matches!(contents, Contents::Record(mark) if u64::from_le_bytes(*mark) == BEGUN)
}

/// That no mark of this very key says that it is in use.
fn check_new<F: NorFlash>(
    id: SenderId,
    place: Place<F>,
    binding: Binding,
) -> Result<Place<F>, MarksError> {
    match look(id, place, binding)? {
        (_, Contents::Record(mark)) if u64::from_le_bytes(mark) > COMPLETE => {
            Err(MarksError::InUse(id))
        }
        (place, _) => Ok(place),
    }
}

fn provision<F: NorFlash>(
    id: SenderId,
    (flash, region): Place<F>,
    binding: Binding,
    first: u64,
) -> Result<HighWaterMark<F>, MarksError> {
    HighWaterMark::provision(flash, region, binding, first)
        .map_err(|error| MarksError::Provision(id, error))
}

/// Stores first marks, that of the own counters behind the others; and then in these that all are stored.
fn store<F: NorFlash, const N: usize>(
    fingerprints: Fingerprints<N>,
    own: SenderId,
    peers: &[Credential; N],
    sent: Place<F>,
    accepted: [Place<F>; N],
) -> Result<HighWaterMarks<F, N>, MarksError> {
    let bindings = fingerprints.accepted();
    let accepted = each(peers, accepted, bindings, |id, place, binding| {
        provision(id, place, binding, BEGUN)
    })?;
    let sent = provision(own, sent, fingerprints.sent(), FIRST_COUNTER.into())?;
    let mut marks = HighWaterMarks {
        sent,
        accepted,
        fingerprints,
    };
    marks.complete(peers)?;
    Ok(marks)
}

/// Reads the marks that are there.
fn find<F: NorFlash, const N: usize>(
    fingerprints: Fingerprints<N>,
    own: SenderId,
    peers: &[Credential; N],
    (flash, region): Place<F>,
    accepted: [Place<F>; N],
) -> Result<HighWaterMarks<F, N>, MarksError> {
    let open = |id, flash, region, binding| {
        HighWaterMark::open(flash, region, binding).map_err(|error| MarksError::Mark(id, error))
    };
    let sent = open(own, flash, region, fingerprints.sent())?;
    let bindings = fingerprints.accepted();
    let accepted = each(peers, accepted, bindings, |id, (flash, region), binding| {
        open(id, flash, region, binding)
    })?;
    let mut marks = HighWaterMarks {
        sent,
        accepted,
        fingerprints,
    };
    // Where a cut came between the last first mark and here.
    marks.complete(peers)?;
    Ok(marks)
}

impl<F: NorFlash, const N: usize> HighWaterMarks<F, N> {
    /// Says that all marks are stored.
    fn complete(&mut self, peers: &[Credential; N]) -> Result<(), MarksError> {
        for (mark, peer) in self.accepted.iter_mut().zip(peers) {
            mark.reserve(BEGUN, 0)
                .map_err(|error| MarksError::Store(peer.id, error))?;
        }
        Ok(())
    }
}

/// What is made of the place of each peer's mark.
fn each<F, T, const N: usize>(
    peers: &[Credential; N],
    places: [Place<F>; N],
    bindings: [Binding; N],
    mut make: impl FnMut(SenderId, Place<F>, Binding) -> Result<T, MarksError>,
) -> Result<[T; N], MarksError> {
    let mut made = Vec::<_, N>::new();
    for ((peer, place), binding) in peers.iter().zip(places).zip(bindings) {
        let pushed = made.push(make(peer.id, place, binding)?);
        debug_assert!(pushed.is_ok(), "there are as many");
    }
    // There is one for each place.
    made.into_array().map_err(|_| MarksError::NotProvisioned)
}

/// Why there are no marks, and no end to start. By the id of the sender whose counters a mark is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MarksError {
    /// A key is none. The key file is at fault.
    Key(SealingKeyError),
    /// The cipher's hardware failed.
    Cipher(CipherError),
    /// All regions are blank: [`HighWaterMarks::provision`] was never asked for.
    NotProvisioned,
    /// This mark cannot be used. The flash is damaged, regions or peers have changed places, or a key is another one
    /// than the flash was provisioned for. New keys must be made and provisioned, unless the mistake can be undone.
    Mark(SenderId, MarkError),
    /// There is a mark of this very key, and it says that the key is in use: nonces would be used twice, or packages
    /// accepted again. The caller is at fault.
    InUse(SenderId),
    /// This first mark could not be stored. The flash is at fault. It may be tried again.
    Provision(SenderId, ProvisionError),
    /// That provisioning has come to its end could not be stored. It may be tried again.
    Store(SenderId, ReserveError),
}

impl fmt::Display for MarksError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Key(error) => error.fmt(f),
            Self::Cipher(error) => error.fmt(f),
            Self::NotProvisioned => f.write_str("no marks were ever provisioned"),
            Self::Mark(id, error) => write!(f, "the mark of sender {id}: {error}"),
            Self::InUse(id) => write!(f, "the key of sender {id} is in use already"),
            Self::Provision(id, error) => write!(f, "the first mark of sender {id}: {error}"),
            Self::Store(id, error) => write!(f, "the mark of sender {id}: {error}"),
        }
    }
}

impl core::error::Error for MarksError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Key(error) => Some(error),
            Self::Cipher(error) => Some(error),
            Self::Mark(_, error) => Some(error),
            Self::Provision(_, error) => Some(error),
            Self::Store(_, error) => Some(error),
            Self::NotProvisioned | Self::InUse(_) => None,
        }
    }
}
