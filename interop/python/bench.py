"""Times of pymavlink: what the Rust benchmark signs and verifies, one frame at a time.

Input: the key and the frames of each message, as JSON. Argument: seconds for each time. Prints its version
and nanoseconds a frame as JSON.
"""

import importlib.metadata
import json
import os
import platform
import sys
import time

os.environ["MAVLINK20"] = "1"

from pymavlink.dialects.v20 import common

SECONDS = float(sys.argv[1])
LEAST_PASSES = 10

given = json.load(sys.stdin)
KEY = bytes.fromhex(given["key"])


def endpoint():
    """A receiver and sender as mavutil's setup_signing makes it."""
    mav = common.MAVLink(None)
    mav.signing.secret_key = KEY
    mav.signing.sign_outgoing = True
    mav.signing.link_id = 7
    return mav


def sign(mav, messages):
    for message in messages:
        message.pack(mav)


def verify(mav, frames):
    for frame in frames:
        mav.decode(frame)


def nanoseconds(call, inputs):
    """Of the passes over them, each with an endpoint that has seen nothing: a tenth is faster."""
    passes = []
    until = time.perf_counter() + SECONDS
    while len(passes) < LEAST_PASSES or time.perf_counter() < until:
        mav = endpoint()
        start = time.perf_counter_ns()
        call(mav, inputs)
        passes.append((time.perf_counter_ns() - start) / len(inputs))
    return sorted(passes)[len(passes) // 10]


times = {}
for message in given["messages"]:
    frames = [bytearray.fromhex(frame) for frame in message["frames"]]
    mav = endpoint()
    decoded = [mav.decode(frame) for frame in frames]
    if mav.signing.goodsig_count != len(frames):
        sys.exit(f"pymavlink accepts {mav.signing.goodsig_count} of {len(frames)} frames of {message['name']}")
    times[f"sign/{message['size']}"] = nanoseconds(sign, decoded)
    times[f"verify/{message['size']}"] = nanoseconds(verify, frames)

print(
    json.dumps(
        {
            "pymavlink": importlib.metadata.version("pymavlink"),
            "python": platform.python_version(),
            "times": times,
        }
    )
)
