//! K1 at one end: what one call does to its keys, from any state of a change.

use mavlink_signing::{
    Authenticate, Frame, FrameRef, KeyChangeError, KeyRing, KeySlot, KeyUse, Profile, ReplayGuard,
    RolloverState, SigningKey, Stamp, Timestamp, Window, sign_frame,
};

use crate::key_memory::{Model, bytes, key};
use crate::model::HEARTBEAT;

/// Keys by their numbers, none of which is 0 or 255, which stand for no key: zeros and erased flash. Two different ones.
#[derive(Clone, Copy, Debug)]
pub struct Before {
    /// How far the change has come.
    pub phase: RolloverState,
    /// Where the key in use before it is.
    pub base: KeySlot,
    /// The key in use before it.
    pub old: u8,
    /// The new one; without meaning in [`RolloverState::Settled`].
    pub new: u8,
    /// With which key a frame was heard in this phase, and not confirmed yet.
    pub heard: Heard,
}

/// With which key the other end was heard since the last step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// Not at all.
    Nothing,
    /// With the key in use before the change.
    Old,
    /// With the new one.
    New,
}

/// What an end is asked to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Call {
    /// To offer the key with this number.
    Offer(u8),
    /// To take it over.
    Apply(u8),
    /// To go over to the new key, if it was heard.
    Confirm,
    /// To drop the old key.
    Retire,
    /// To take an offer back.
    Withdraw,
}

impl Before {
    /// The new key, if there is one.
    const fn second(self) -> Option<u8> {
        match self.phase {
            RolloverState::Settled => None,
            _ => Some(self.new),
        }
    }

    /// Whether the other end was heard with a new key that is not confirmed yet: then and only then the
    /// end goes over to it.
    fn is_due(self) -> bool {
        let unconfirmed = matches!(self.phase, RolloverState::Offered | RolloverState::Applied);
        unconfirmed && self.heard == Heard::New
    }

    const fn signs(self) -> u8 {
        match self.phase {
            RolloverState::Settled | RolloverState::Offered => self.old,
            RolloverState::Applied | RolloverState::Confirmed => self.new,
        }
    }

    /// The state after a call: phase, keys, and where the old one is; or why there is none. Nothing is stored if it is
    /// the same. No key ever moves to the other slot: what becomes the old one has its slot already.
    fn after(self, call: Call) -> Result<State, Rejected> {
        let Self {
            phase,
            base,
            old,
            new,
            ..
        } = self;
        let to = |phase, old, new| Ok((phase, base, old, new));
        let same = to(phase, old, new);
        let newest = self.second().unwrap_or(old);
        let heard = self.is_due();
        match call {
            Call::Offer(0 | 255) | Call::Apply(0 | 255) => Err(Rejected::Key),
            Call::Offer(key) if key == newest => same,
            Call::Offer(key) if phase == RolloverState::Settled => {
                to(RolloverState::Offered, old, key)
            }
            // Two ends that were both told to offer it would wait for each other.
            Call::Apply(key) if key == newest && phase == RolloverState::Offered => {
                to(RolloverState::Applied, old, new)
            }
            Call::Apply(key) if key == newest => same,
            Call::Apply(key) if phase == RolloverState::Settled => {
                to(RolloverState::Applied, old, key)
            }
            Call::Apply(key) if phase == RolloverState::Applied && key == old && !heard => {
                to(RolloverState::Settled, old, old)
            }
            Call::Offer(_) | Call::Apply(_) => Err(Rejected::UnderWay),
            Call::Confirm if heard => to(RolloverState::Confirmed, old, new),
            Call::Confirm => same,
            Call::Retire if phase == RolloverState::Confirmed => {
                Ok((RolloverState::Settled, base.other(), new, new))
            }
            Call::Retire => Err(Rejected::NotConfirmed),
            Call::Withdraw if phase == RolloverState::Offered && !heard => {
                to(RolloverState::Settled, old, old)
            }
            Call::Withdraw => Err(Rejected::NotOffered),
        }
    }

    /// Where the key that it signs with is.
    fn signing_slot(self) -> KeySlot {
        if self.signs() == self.old {
            self.base
        } else {
            self.base.other()
        }
    }

    /// What a frame that is signed with this key is told by; `None` if it is neither of the two.
    fn used(self, number: u8) -> Option<KeyUse> {
        if number == self.old {
            let former = self.signs() != number || self.is_due();
            Some(KeyUse {
                slot: self.base,
                former,
            })
        } else {
            (self.second() == Some(number)).then_some(KeyUse {
                slot: self.base.other(),
                former: false,
            })
        }
    }
}

/// Phase, where the old key is, the old and the new key. Settled, one key is both.
type State = (RolloverState, KeySlot, u8, u8);

/// Why a call is rejected whatever the memory does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rejected {
    Key,
    UnderWay,
    NotConfirmed,
    NotOffered,
}

/// K1, one call at one end, from any state: it ends in the state that the rule says, or is rejected.
/// What is stored is that state, before it has an effect; if it cannot be stored, or the call is
/// rejected, nothing changes. In every state the end signs with the old key until it has heard the new
/// one or was given it. It accepts each key that it may be sent: the old one until it is retired, the
/// new one until it is given up.
///
/// Each key has a slot of its own, which it keeps for as long as it is kept. Of a frame it is told which key it was
/// signed with, and that this is a former one if and only if the end signs with another in its place. So a frame under
/// the old key is never taken for one under the new. Only of the new key's slot counts as heard.
///
/// `stores` says whether the memory does what it is told.
///
/// # Errors
///
/// The rejection.
///
/// # Panics
///
/// If the property does not hold.
pub fn one_call<P: Profile>(
    before: Before,
    call: Call,
    stores: bool,
) -> Result<(), KeyChangeError> {
    let Before {
        phase,
        base,
        old,
        new,
        heard,
    } = before;
    let mut keys = KeyRing::<P>::resume(base, key(old), key(new), phase);
    match heard {
        Heard::Nothing => {}
        Heard::Old => hears(&mut keys, old),
        Heard::New => hears(&mut keys, new),
    }
    assert_eq!(keys.confirm_pending(), before.is_due());
    if let Call::Offer(number @ 1..=254) | Call::Apply(number @ 1..=254) = call {
        let begins = phase == RolloverState::Settled && number != old;
        let slot = keys.slot_for(&key(number));
        assert_eq!(slot, begins.then_some(base.other()));
    }
    let mut memory = Model::holding(phase, base, old, new);
    if !stores {
        memory.fails();
    }
    let result = match call {
        Call::Offer(number) => keys.offer(&bytes(number), &mut memory),
        Call::Apply(number) => keys.apply(&bytes(number), &mut memory),
        Call::Confirm => keys.confirm(&mut memory),
        Call::Retire => keys.retire(&mut memory),
        Call::Withdraw => keys.withdraw(&mut memory),
    };

    let unchanged = (phase, base, old, before.second().unwrap_or(old));
    let rule = before.after(call);
    let expected = match rule {
        Ok(after) if after == (phase, base, old, new) => (Ok(()), unchanged),
        Ok(_) if !stores => (Err(None), unchanged),
        Ok(after) => (Ok(()), after),
        Err(rejected) => (Err(Some(rejected)), unchanged),
    };
    assert_eq!(result.map_err(rejection), expected.0);
    let (phase, base, old, new) = expected.1;
    assert_eq!(keys.rollover_state(), phase);
    assert_eq!(memory.stored(), expected.1);
    let due = matches!(phase, RolloverState::Offered | RolloverState::Applied) && before.is_due();
    assert_eq!(keys.confirm_pending(), due);
    let after = Before {
        phase,
        base,
        old,
        new,
        heard: if due { Heard::New } else { Heard::Nothing },
    };
    assert_eq!(signed(keys.signing())[LAST], after.signs());
    assert_eq!(keys.signing_slot(), after.signing_slot());
    let there = |slot| keys.key(slot).map(|key| signed(key)[LAST]);
    assert_eq!(there(base), Some(old));
    assert_eq!(there(base.other()), after.second());
    let other = match call {
        Call::Offer(number @ 1..=254) | Call::Apply(number @ 1..=254) => Some(number),
        _ => None,
    };
    for number in [before.old, before.new].into_iter().chain(other) {
        let accepted = accepts(&keys, number);
        assert_eq!(accepted, after.used(number));
        if let (Some(used), Some(was)) = (accepted, before.used(number)) {
            assert_eq!(used.slot, was.slot, "a key keeps its slot");
        }
    }
    result
}

/// The rejection; `None` for a memory that failed.
fn rejection(error: KeyChangeError) -> Option<Rejected> {
    match error {
        KeyChangeError::Key(_) => Some(Rejected::Key),
        KeyChangeError::UnderWay => Some(Rejected::UnderWay),
        KeyChangeError::NotConfirmed => Some(Rejected::NotConfirmed),
        KeyChangeError::NotOffered => Some(Rejected::NotOffered),
        _ => None,
    }
}

/// Bytes of the frame that is signed here: nothing in it but its header.
const SIZE: usize = 25;
/// Its last byte: with the tag that models of profiles make of a key, the number of the key.
const LAST: usize = SIZE - 1;

fn signed<P: Profile>(key: &SigningKey<P>) -> [u8; SIZE] {
    let mut frame = Frame::new(HEARTBEAT, &[]).expect("in every dialect");
    let stamp = Stamp {
        link_id: 1,
        timestamp: Timestamp::ZERO,
    };
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    *frame.as_bytes().first_chunk().expect("no payload")
}

fn accepts<P: Profile>(keys: &KeyRing<P>, number: u8) -> Option<KeyUse> {
    let bytes = signed(&key::<P>(number));
    let frame = FrameRef::parse(&bytes).expect("a whole frame");
    keys.authenticate(frame).ok().map(|frame| frame.key())
}

fn hears<P: Profile>(keys: &mut KeyRing<P>, number: u8) {
    let window = Window { past: 0, ahead: 0 };
    let bytes = signed(&key::<P>(number));
    let frame = FrameRef::parse(&bytes).expect("a whole frame");
    let authentic = keys.authenticate(frame).expect("one of its keys");
    let used = authentic.key();
    let verified = ReplayGuard::new(1, window).admit(authentic, Timestamp::ZERO);
    let verified = verified.expect("the first");
    assert_eq!(verified.key(), used);
    keys.on_accepted(&verified);
}

/// Every state, with `old` and `new` as they are given, `old` in the slot `base`.
#[cfg(any(test, kani))]
fn states(base: KeySlot, old: u8, new: u8) -> [Before; 11] {
    use Heard::{New, Nothing, Old};
    use RolloverState::{Applied, Confirmed, Offered, Settled};
    [
        (Settled, Nothing),
        (Offered, Nothing),
        (Offered, New),
        (Applied, Nothing),
        (Applied, New),
        (Confirmed, Nothing),
        // Heard with another key than the one that counts, or once more.
        (Offered, Old),
        (Applied, Old),
        (Confirmed, Old),
        (Confirmed, New),
        (Settled, Old),
    ]
    .map(|(phase, heard)| Before {
        phase,
        base,
        old,
        new,
        heard,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::AnyTag;
    use mavlink_signing::{Hmac, KEY_SIZE, KeyError, passphrase_key};

    /// Every call in every state; of keys it matters only which are the same.
    #[test]
    fn k1_every_call() {
        let mut rejected = 0;
        let bases = [KeySlot::A, KeySlot::B];
        for before in bases.map(|base| states(base, 1, 2)).concat() {
            for number in [0, 1, 2, 3, 255] {
                let calls = [
                    Call::Offer(number),
                    Call::Apply(number),
                    Call::Confirm,
                    Call::Retire,
                    Call::Withdraw,
                ];
                for call in calls {
                    for stores in [true, false] {
                        rejected += usize::from(one_call::<AnyTag>(before, call, stores).is_err());
                    }
                }
            }
        }
        assert!(rejected > 0);
    }

    /// What everybody knows is no key to change to, by no call, and is none to keep.
    #[test]
    fn k1_no_key_that_everybody_knows() {
        let known = [
            (*b"mavseal demo key, not a secret!!", KeyError::Published),
            (passphrase_key("mavseal-demonstration"), KeyError::Published),
            (passphrase_key(""), KeyError::EmptyPassphrase),
            ([0; KEY_SIZE], KeyError::AllZero),
            ([0xFF; KEY_SIZE], KeyError::Erased),
        ];
        for (bytes, error) in known {
            assert_eq!(KeyRing::<Hmac>::prepare(&bytes).err(), Some(error));
            let mut keys = KeyRing::from(key::<Hmac>(1));
            let mut memory = Model::new();
            for result in [
                keys.offer(&bytes, &mut memory),
                keys.apply(&bytes, &mut memory),
            ] {
                assert_eq!(result, Err(KeyChangeError::Key(error)));
                assert_eq!(keys.rollover_state(), RolloverState::Settled);
            }
            assert_eq!(memory.stored(), Model::new().stored());
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::{AnyTag, any_slot};

    /// The key that is offered. It may be either of the others. Of keys it matters only which are the
    /// same: one number, known to the solver, is as good as any.
    const NUMBER: u8 = 7;

    /// One call in the state with this number, which is known to the solver.
    fn any_call<const STATE: usize>(call: impl Fn(u8) -> Call) -> Result<(), KeyChangeError> {
        let (old, new): (u8, u8) = (kani::any(), kani::any());
        kani::assume(old != 0 && old != 255 && new != 0 && new != 255 && old != new);
        let before = states(any_slot(), old, new)[STATE];
        one_call::<AnyTag>(before, call(NUMBER), kani::any())
    }

    macro_rules! calls {
        ($($name:ident $state:literal $call:expr;)*) => {$(
            #[kani::proof]
            #[kani::unwind(33)]
            #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
            fn $name() {
                let result = any_call::<$state>($call);
                kani::cover!(result.is_ok(), "done");
                kani::cover!(result.is_err(), "rejected");
            }
        )*};
    }

    /// To go over is not rejected, and nothing happens, whatever the memory does.
    macro_rules! stays {
        ($($name:ident $state:literal;)*) => {$(
            #[kani::proof]
            #[kani::unwind(33)]
            #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
            fn $name() {
                assert_eq!(any_call::<$state>(|_| Call::Confirm), Ok(()));
                kani::cover!(true, "nothing happens");
            }
        )*};
    }

    stays! {
        k1_initiator_stays_when_heard_with_the_old 6;
        k1_stays_when_heard_with_the_old 7;
    }

    calls! {
        k1_offers_when_settled 0 Call::Offer;
        k1_offers_when_applied 3 Call::Offer;
        k1_takes_over_when_settled 0 Call::Apply;
        k1_takes_over_when_offered 1 Call::Apply;
        k1_takes_over_when_applied 3 Call::Apply;
        k1_takes_over_when_offered_and_heard 2 Call::Apply;
        k1_takes_over_when_heard 4 Call::Apply;
        k1_takes_over_when_confirmed 5 Call::Apply;
        k1_initiator_goes_over_when_heard 2 |_| Call::Confirm;
        k1_goes_over_when_heard 4 |_| Call::Confirm;
        k1_retires_when_confirmed 5 |_| Call::Retire;
        k1_withdraws_when_offered 1 |_| Call::Withdraw;
    }

    #[kani::proof]
    #[kani::unwind(33)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn k1_takes_no_key_of_zeros() {
        let rejected = any_call::<0>(|_| Call::Apply(0));
        assert!(matches!(rejected, Err(KeyChangeError::Key(_))));
        kani::cover!(true, "rejected");
    }

    #[kani::proof]
    #[kani::unwind(33)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn k1_takes_no_erased_flash() {
        let rejected = any_call::<0>(|_| Call::Apply(255));
        assert!(matches!(rejected, Err(KeyChangeError::Key(_))));
        kani::cover!(true, "rejected");
    }

    /// An end that was heard with the new key has it: it is not taken back.
    #[kani::proof]
    #[kani::unwind(33)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn k1_withdraws_no_more_when_heard() {
        let rejected = any_call::<2>(|_| Call::Withdraw);
        assert_eq!(rejected, Err(KeyChangeError::NotOffered));
        kani::cover!(true, "rejected");
    }

    #[kani::proof]
    #[kani::unwind(33)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn k1_retires_no_earlier() {
        let rejected = any_call::<4>(|_| Call::Retire);
        assert_eq!(rejected, Err(KeyChangeError::NotConfirmed));
        kani::cover!(true, "rejected");
    }
}
