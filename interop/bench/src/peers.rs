//! The peers written in Rust, each by the shortest way that does all that a receiver must.

pub mod mavio;
pub mod mavlink;

#[cfg(test)]
mod tests {
    use mavlink_signing::{FrameRef, Standard, authenticate, field::MAX_FRAME_SIZE};

    use super::{mavio, mavlink};
    use crate::{here, messages::MESSAGES};

    #[test]
    fn peers_sign_what_is_signed_here() {
        let key = here::key::<Standard>();
        for message in &MESSAGES {
            let here = message.frames::<Standard>().remove(0);
            let mut buffer = [0; MAX_FRAME_SIZE];
            let mut endpoint = mavio::endpoint();
            let length = mavio::sign(message, &message.payload(), &mut endpoint, &mut buffer);
            assert_eq!(buffer[..length], here, "mavio, {}", message.name);

            // It signs for the machine's clock.
            let frame = mavlink::sign(&mavlink::message(message), &mavlink::endpoint());
            let frame = FrameRef::parse(frame.raw_bytes()).expect("a frame");
            assert_eq!(
                frame.as_bytes().len(),
                here.len(),
                "mavlink, {}",
                message.name
            );
            assert!(
                authenticate(frame, &key).is_ok(),
                "mavlink, {}",
                message.name
            );
        }
    }
}
