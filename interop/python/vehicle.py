"""A vehicle that cannot sign: pymavlink on the signer's local side, until its input ends.

Argument: the TCP port. Prints the kind of each message that comes, and at the end what it sent and what
came, as JSON.
"""

import json
import os
import select
import sys
import time

os.environ["MAVLINK20"] = "1"

from pymavlink import mavutil

PERIOD = 0.05

link = mavutil.mavlink_connection(
    f"tcp:127.0.0.1:{sys.argv[1]}", source_system=1, source_component=1, dialect="ardupilotmega"
)
mavlink = mavutil.mavlink
started = time.monotonic()
commands = []
came = {}
sent = {}
turn = 0


def count(message):
    sent[message.get_type()] = sent.get(message.get_type(), 0) + 1


link.mav.set_send_callback(count)


def telemetry():
    """A frame of one kind or another; the heartbeat once in a while."""
    now = int((time.monotonic() - started) * 1000)
    swing = (turn % 100) / 100
    kinds = [
        lambda: link.mav.attitude_send(now, swing, -swing, swing / 2, 0, 0, 0),
        lambda: link.mav.global_position_int_send(now, 473977418, 85455939, 488000 + turn, turn, 0, 0, 0, 9000),
        lambda: link.mav.vfr_hud_send(swing, swing, 90, 50, 488, 0),
        lambda: link.mav.sys_status_send(0, 0, 0, 250, 12600, 100, 99, 0, 0, 0, 0, 0, 0),
        lambda: link.mav.statustext_send(mavlink.MAV_SEVERITY_INFO, f"turn {turn}".encode()),
    ]
    if turn % 25 == 0:
        link.mav.heartbeat_send(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 81, 0, mavlink.MAV_STATE_STANDBY
        )
    else:
        kinds[turn % len(kinds)]()


while not (select.select([sys.stdin], [], [], 0)[0] and not sys.stdin.readline()):
    telemetry()
    turn += 1
    while (message := link.recv_msg()) is not None:
        kind = message.get_type()
        came[kind] = came.get(kind, 0) + 1
        print(kind, flush=True)
        if kind == "COMMAND_LONG":
            commands.append([message.get_srcSystem(), message.command, message.param1])
            link.mav.command_ack_send(message.command, mavlink.MAV_RESULT_ACCEPTED)
    time.sleep(PERIOD)

print(json.dumps({"sent": sent, "commands": commands, "came": came}))
