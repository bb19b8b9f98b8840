//! Every difference between a peer and the core: which, where, and why.
//!
//! A difference that is not here fails the run, and so does one of these that is not seen any more.

/// A scenario in which a peer does something else.
pub(crate) struct Difference {
    pub(crate) peer: &'static str,
    pub(crate) scenario: &'static str,
    /// What the peer lets pass, frame by frame.
    pub(crate) passes: &'static [bool],
    pub(crate) reason: &'static str,
}

/// The name of what a peer signs and the core verifies, among scenarios.
pub(crate) const SIGNED_THERE: &str = "signed there, verified here";

const PEERS: [(&str, &[&[Row]]); 4] = [
    ("pymavlink", &[THEIR_CLOCK, PYMAVLINK]),
    ("mavlink", &[THEIR_CLOCK, MAVLINK]),
    ("mavio", &[MAVIO_AS_DOCUMENTED]),
    ("mavio, flag first", &[MAVIO]),
];

type Row = (&'static str, &'static [bool], &'static str);

const NO_UPPER_BOUND: &str = "The peer takes stamps from any future and sets its clock by them; here a stamp has to be \
    within a minute of the clock, either way.";
const CLOCK_TAKEN_ALONG: &str = "An authentic frame from the future took the peer's clock along, and everything \
    stamped with the right time is now old.";
const MINUTE_FOR_NEW_ONLY: &str = "The guide's list says that packets a minute behind are dropped, its text says so of \
    new streams alone. The peer reads the text; here no frame passes.";

/// Of peers that set their clock by the frames that they accept.
const THEIR_CLOCK: &[Row] = &[
    (
        "a known stream, 88 s behind",
        &[true, true, true],
        MINUTE_FOR_NEW_ONLY,
    ),
    ("2 minutes ahead", &[true], NO_UPPER_BOUND),
    (
        "one 2 minutes ahead, then the same stream",
        &[true, false],
        CLOCK_TAKEN_ALONG,
    ),
    (
        "one 2 minutes ahead, then another stream",
        &[true, false],
        CLOCK_TAKEN_ALONG,
    ),
    ("one stamped years ahead", &[true, false], CLOCK_TAKEN_ALONG),
    ("the last stamp of all", &[true], NO_UPPER_BOUND),
];

const UNKNOWN_HANDED_ON: &str = "A message that pymavlink does not know comes out as MAVLink_unknown before checksum and \
    signature are looked at. Without a definition there is no right checksum, so here it is rejected.";

const PYMAVLINK: &[Row] = &[
    ("message changed to none", &[true], UNKNOWN_HANDED_ON),
    (
        "undefined message, signed with the key",
        &[true],
        UNKNOWN_HANDED_ON,
    ),
    (
        "a forged one 30 s ahead, then the same stream",
        &[false, false],
        "pymavlink stores a stream's stamp before it compares the tag: a forger shuts a stream out.",
    ),
];

const MAVLINK: &[Row] = &[
    (
        "32-bit system id, signed with the key",
        &[true],
        "The crate knows a flag, 0x02, that the guide does not define; here a frame with an unknown \
         flag is dropped, as the guide says.",
    ),
    (
        "undefined message, signed with the key",
        &[true],
        "For a message that is not in the dialect the crate takes a CRC_EXTRA of zero, and hands the \
         raw frame on; here it is rejected.",
    ),
];

const NO_TIMESTAMPS: &str =
    "mavio checks tags and leaves timestamps to its caller: it has no replay protection.";

const MAVIO_AS_DOCUMENTED: &[Row] = &[(
    SIGNED_THERE,
    &[false],
    "add_signature sets the signed flag after the checksum was made, which covers it: everybody \
     rejects the frame as damaged.",
)];

const CUTS_FIRST: &str = "mavio cuts the zeros of a received payload before it computes the checksum, and keeps one \
    byte of none: a frame whose sender did not cut, or cut all, is damaged to it.";

const MAVIO: &[Row] = &[
    (
        "a payload with zeros at its end, not cut",
        &[false],
        CUTS_FIRST,
    ),
    ("an empty payload", &[false], CUTS_FIRST),
    (
        "undefined flag, signed with the key",
        &[true],
        "mavio hands on frames with flags that it does not know; the guide has them dropped.",
    ),
    ("an older one", &[true, true], NO_TIMESTAMPS),
    ("another with the same stamp", &[true, true], NO_TIMESTAMPS),
    (
        "other links, systems and components with the same stamp",
        &[true, true, true, true, true],
        NO_TIMESTAMPS,
    ),
    ("a new stream, 61 s behind", &[true], NO_TIMESTAMPS),
    (
        "a known stream, 88 s behind",
        &[true, true, true],
        NO_TIMESTAMPS,
    ),
    ("2 minutes ahead", &[true], NO_TIMESTAMPS),
    (
        "one 2 minutes ahead, then the same stream",
        &[true, true],
        NO_TIMESTAMPS,
    ),
    (
        "one 2 minutes ahead, then another stream",
        &[true, true],
        NO_TIMESTAMPS,
    ),
    ("one stamped years ahead", &[true, true], NO_TIMESTAMPS),
    ("the same again", &[true, true], NO_TIMESTAMPS),
    ("the last stamp of all", &[true], NO_TIMESTAMPS),
];

/// All of them.
pub(crate) fn all() -> impl Iterator<Item = Difference> {
    PEERS.into_iter().flat_map(|(peer, groups)| {
        groups
            .iter()
            .copied()
            .flatten()
            .map(move |&(scenario, passes, reason)| Difference {
                peer,
                scenario,
                passes,
                reason,
            })
    })
}
