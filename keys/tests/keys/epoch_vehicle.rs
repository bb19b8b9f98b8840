// What this image seals with, and whom it hears. Made from the key file: keep it secret.

/// What this image seals with.
pub static OWN: ::mavlink_commsec::Credential<::mavlink_commsec::EpochSenderId> = ::mavlink_commsec::Credential {
    id: ::mavlink_commsec::EpochSenderId(7),
    key: [15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0],
    salt: 9219834,
};

/// Whom it hears.
pub static PEERS: [::mavlink_commsec::Credential<::mavlink_commsec::EpochSenderId>; 1] = [
    ::mavlink_commsec::Credential {
        id: ::mavlink_commsec::EpochSenderId(5),
        key: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
        salt: 17235,
    },
];
