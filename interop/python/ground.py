"""A ground station: pymavlink with setup_signing on the signer's link side.

Arguments: the TCP port, the key in hexadecimal digits, the link id. Prints what came as JSON.
"""

import json
import os
import sys
import time

os.environ["MAVLINK20"] = "1"

from pymavlink import mavutil

PATIENCE = 120
TELEMETRY = 200
# MAV_CMD_REQUEST_MESSAGE, with which no vehicle does harm.
COMMAND = 512

port, key, link_id = sys.argv[1], bytes.fromhex(sys.argv[2]), int(sys.argv[3])
link = mavutil.mavlink_connection(
    f"tcp:127.0.0.1:{port}", source_system=255, source_component=190, dialect="ardupilotmega"
)
link.setup_signing(key, sign_outgoing=True, link_id=link_id)
signing = link.mav.signing

received = {"frames": 0, "signed": 0, "gaps": 0, "rejected": 0, "links": []}
authentic = []
acknowledged = []
last = None


def receive():
    """The next frame, counted."""
    global last
    message = link.recv_match(blocking=True, timeout=PATIENCE)
    if message is None:
        sys.exit("nothing comes from the vehicle")
    if message.get_type() == "BAD_DATA":
        received["rejected"] += 1
        return message
    received["frames"] += 1
    received["signed"] += message.get_signed()
    if message.get_link_id() not in received["links"]:
        received["links"].append(message.get_link_id())
    if last is not None and message.get_seq() != (last + 1) % 256:
        received["gaps"] += 1
    last = message.get_seq()
    return message


def send(parameter):
    link.mav.command_long_send(1, 1, COMMAND, 0, parameter, 0, 0, 0, 0, 0, 0)


def command(parameter):
    """A command, and the wait for its acknowledgement."""
    send(parameter)
    authentic.append([255, COMMAND, float(parameter)])
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        message = receive()
        if message.get_type() == "COMMAND_ACK" and message.command == COMMAND:
            acknowledged.append(message.result)
            return
    sys.exit("a command was not acknowledged")


while receive().get_type() != "HEARTBEAT":
    pass
link.mav.heartbeat_send(mavutil.mavlink.MAV_TYPE_GCS, mavutil.mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
command(1)
command(2)

# What must not reach the vehicle: signed with another key, and not signed at all.
signing.secret_key = bytes(32 * [0x5A])
send(66)
signing.secret_key = key
signing.sign_outgoing = False
send(67)
signing.sign_outgoing = True

command(3)
while received["frames"] < TELEMETRY:
    receive()

# As MAVProxy has it: given no link id, it takes over that of the vehicle which it knows it talks to.
signing.link_id = 0
link.target_system, link.target_component = 1, 1
while receive().get_type() != "HEARTBEAT":
    pass
received["adopted"] = signing.link_id
command(4)

# The heartbeat is authentic too.
print(json.dumps({**received, "authentic": authentic, "acknowledged": len(acknowledged), "passed": len(authentic) + 1}))
