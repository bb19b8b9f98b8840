"""commsec packages with the package cryptography: one order a line in, one answer a line out.

seal FORMAT KEY SALT ID EPOCH COUNTER MESSAGE: the package.
open FORMAT KEY SALT PACKAGE: ID EPOCH COUNTER MESSAGE, or "no".

Bytes are hexadecimal digits. The format is "id-counter" or "counter-epoch-id"; the former has no epoch: 0.
"""

import struct
import sys

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

TAG = 8


def header(form, sender, epoch, counter):
    if form == "id-counter":
        return struct.pack(">II", sender, counter)
    return struct.pack(">IHH", counter, epoch, sender)


def fields(form, front):
    if form == "id-counter":
        sender, counter = struct.unpack(">II", front)
        return sender, 0, counter
    counter, epoch, sender = struct.unpack(">IHH", front)
    return sender, epoch, counter


def seal(form, key, salt, sender, epoch, counter, message):
    front = header(form, int(sender), int(epoch), int(counter))
    sealed = AESGCM(bytes.fromhex(key)).encrypt(bytes.fromhex(salt) + front, bytes.fromhex(message), None)
    # Of the 16 bytes of tag at its end the first 8 are sent.
    return (front + sealed[: len(sealed) - 16 + TAG]).hex()


def open_package(form, key, salt, package):
    package = bytes.fromhex(package)
    front, sealed, tag = package[:8], package[8:-TAG], package[-TAG:]
    mode = modes.GCM(bytes.fromhex(salt) + front, tag, min_tag_length=TAG)
    decryptor = Cipher(algorithms.AES(bytes.fromhex(key)), mode).decryptor()
    message = decryptor.update(sealed)
    try:
        message += decryptor.finalize()
    except InvalidTag:
        return "no"
    return " ".join([*map(str, fields(form, front)), message.hex()])


VERBS = {"seal": seal, "open": open_package}

for line in sys.stdin:
    command, *words = line.split()
    print(VERBS[command](*words), flush=True)
