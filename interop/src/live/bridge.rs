//! An emulated serial port as a TCP port that a ground station can connect to.

use std::{
    io,
    net::{Ipv4Addr, Shutdown, TcpListener, TcpStream},
    thread,
};

use anyhow::Result;

/// Gives the TCP port; the first to connect to it is at the other end of `serial`.
pub(super) fn open(mut serial: TcpStream) -> Result<u16> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let port = listener.local_addr()?.port();
    thread::spawn(move || -> io::Result<()> {
        let (mut client, _) = listener.accept()?;
        client.set_nodelay(true)?;
        let (mut from_client, mut to_serial) = (client.try_clone()?, serial.try_clone()?);
        thread::spawn(move || io::copy(&mut from_client, &mut to_serial));
        let copied = io::copy(&mut serial, &mut client);
        // The emulator has ended, or the client has: whoever is left shall hear of it.
        let _ = client.shutdown(Shutdown::Both);
        copied.map(drop)
    });
    Ok(port)
}
