#!/usr/bin/env python3
"""A controller outside the vehicle: PID from the estimate and the reference to a wrench, over the law `external`.

The vehicle keeps allocation, limits and fallback. Axes that are not steered here stay with the vehicle's own
substitute, and so do all of them when the requests stop for half a second.

    supertwin up --trial external --no-mission &
    python tests/clients/external_pid.py --axes yaw
    python tests/clients/external_pid.py --axes surge,sway,heave,yaw --seconds 60
"""

import json
import math
import sys
import time

import zenoh

from supertwin_client import Refused, Vehicle, message, parser

# In newtons or newton metres per m/s (surge, sway), m (heave) and rad (yaw). As in config/controllers/external.toml.
GAINS = {
    "surge": {"kp": 300.0, "ki": 60.0, "kd": 0.0},
    "sway": {"kp": 300.0, "ki": 60.0, "kd": 0.0},
    "heave": {"kp": 250.0, "ki": 25.0, "kd": 120.0},
    "yaw": {"kp": 40.0, "ki": 12.0, "kd": 20.0},
}
UNIT = {"surge": "surge_n", "sway": "sway_n", "heave": "heave_n", "yaw": "yaw_nm"}
# The integral stays within what the thrusters can give.
MOST = {"surge": 60.0, "sway": 60.0, "heave": 40.0, "yaw": 10.0}


def errors(nav, reference):
    """For each axis: the error, and its rate where the law uses one."""
    turn = math.remainder(reference["heading_rad"] - nav["heading_rad"], 2 * math.pi)
    velocity = nav["velocity"]
    return {
        "surge": (reference["surge_m_per_s"] - velocity["surge_m_per_s"], 0.0),
        "sway": (reference["sway_m_per_s"] - velocity["sway_m_per_s"], 0.0),
        "heave": (
            reference["depth_m"] - nav["depth_m"],
            reference["depth_m_per_s"] - velocity["heave_m_per_s"],
        ),
        "yaw": (turn, reference["heading_rad_per_s"] - velocity["yaw_rad_per_s"]),
    }


def choose_law(vehicle):
    """Hands over to the law `external`, for which alone the authority is needed, unless it steers already."""
    telemetry = vehicle.newest("telemetry/controller")
    if message(telemetry.recv())["data"]["signals"]["controller/law"] == "external":
        return
    vehicle.acquire()
    tick = vehicle.command("controller", "law", "external")
    while message(telemetry.recv())["tick"] <= tick:
        pass
    vehicle.release()
    print("the law external is in command", flush=True)


def main():
    arguments = parser(__doc__)
    arguments.add_argument("--axes", default="yaw", help="which to steer: surge,sway,heave,yaw")
    arguments.add_argument("--seconds", metavar="S", type=float, help="end after this long")
    arguments = arguments.parse_args()
    axes = arguments.axes.split(",")
    if not set(axes) <= set(GAINS):
        sys.exit(f"--axes {arguments.axes}: must be some of {','.join(GAINS)}")

    with Vehicle(arguments, "external-pid") as vehicle:
        nav, references = vehicle.newest("estimator/nav"), vehicle.newest("guidance/reference")
        # Late is worse than lost: a request that does not get through is replaced by the next one.
        wire = vehicle.session.declare_publisher(
            vehicle.key("controller/wrench_request"),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )
        try:
            choose_law(vehicle)
        except Refused as refused:
            print(refused, file=sys.stderr)
            return 1

        integral, seq, before = dict.fromkeys(axes, 0.0), 0, None
        reference = message(references.recv())["data"]
        end = time.monotonic() + (arguments.seconds or float("inf"))
        print(f"steering {arguments.axes}", flush=True)
        try:
            while time.monotonic() < end:
                # The estimate sets the pace: one request for each.
                state = message(nav.recv())
                if (sample := references.try_recv()) is not None:
                    reference = message(sample)["data"]
                dt = 0.0 if before is None else state["sim_time_s"] - before
                before = state["sim_time_s"]
                wrench = {}
                if reference["mode"] == "neutral":
                    # Nobody wants a force: the integral must not wind up meanwhile.
                    integral = dict.fromkeys(axes, 0.0)
                else:
                    error = errors(state["data"], reference)
                    for axis in axes:
                        gain, (e, rate) = GAINS[axis], error[axis]
                        integral[axis] += gain["ki"] * e * dt
                        integral[axis] = max(-MOST[axis], min(MOST[axis], integral[axis]))
                        wrench[UNIT[axis]] = gain["kp"] * e + integral[axis] + gain["kd"] * rate
                seq += 1
                # What the vehicle needs to know of a message: whose, at which tick, and its number, from 1 on.
                envelope = {"source": vehicle.client, "tick": state["tick"], "seq": seq, "data": wrench}
                wire.put(json.dumps(envelope))
        except KeyboardInterrupt:
            pass
        print(f"{seq} requests sent")
    return 0


if __name__ == "__main__":
    sys.exit(main())
