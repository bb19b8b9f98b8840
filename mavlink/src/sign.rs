//! Signing a frame in place.

use crate::error::SignError;
use crate::frame::Frame;
use crate::key::SigningKey;
use crate::profile::Profile;
use crate::time::Stamp;

/// Signs `frame`. Sets the signed flag (incompatibility flag 0x01) and recomputes the checksum. Then
/// appends link id, timestamp and the 6-byte tag over everything before it.
///
/// `stamp` comes from the link's [`Stamper`](crate::Stamper). Sign when sending, not earlier: the
/// receiver rejects a frame that has waited longer than its window.
///
/// # Errors
///
/// [`SignError::AlreadySigned`]. The frame is unchanged then.
pub fn sign_frame<P: Profile>(
    frame: &mut Frame,
    key: &SigningKey<P>,
    stamp: Stamp,
) -> Result<(), SignError> {
    if frame.is_signed() {
        return Err(SignError::AlreadySigned);
    }
    frame.sign(stamp, |covered| key.tag(covered));
    Ok(())
}
