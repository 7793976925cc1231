#!/usr/bin/env python3
"""A short inspection: descend, follow the net to starboard, turn back to port, stop.

    supertwin up --no-mission &
    python tests/clients/mission.py --depth 3 --leg 30
"""

import sys

from supertwin_client import Refused, Vehicle, message, parser


def main():
    arguments = parser(__doc__)
    arguments.add_argument("--depth", metavar="M", type=float, default=3.0, help="metres below the surface")
    arguments.add_argument("--leg", metavar="S", type=float, default=30.0, help="simulated seconds in each direction")
    arguments.add_argument("--speed", metavar="M/S", type=float, default=0.2, help="along the net")
    arguments = arguments.parse_args()

    with Vehicle(arguments, "mission") as vehicle:
        nav = vehicle.newest("estimator/nav")

        def wait_until(done):
            """Simulated time passes at the vehicle's pace, so waiting means looking at its messages."""
            while True:
                now = message(nav.recv())
                if done(now):
                    return now

        def command(**values):
            """Commands guidance; the first estimate after all of it applies."""
            tick = max([vehicle.command("guidance", name, value) for name, value in values.items()])
            return wait_until(lambda now: now["tick"] > tick)

        def travel(since):
            wait_until(lambda now: now["sim_time_s"] >= since["sim_time_s"] + arguments.leg)

        def say(now, words):
            data = now["data"]
            where = f"depth {data['depth_m']:.2f} m, net at {data['net']['distance_m']:.2f} m"
            print(f"{now['sim_time_s']:7.1f} s  {words}  ({where})", flush=True)

        try:
            vehicle.acquire()
            say(command(mode="depth_heading_hold", depth_m=arguments.depth), f"descending to {arguments.depth} m")
            wait_until(lambda now: abs(now["data"]["depth_m"] - arguments.depth) < 0.2)

            # Each leg begins with the tick at which its command applies, however long the answer took.
            leg = command(direction="starboard", speed_m_per_s=arguments.speed, mode="follow_net")
            say(leg, "following the net to starboard")
            travel(leg)

            leg = command(direction="port")
            say(leg, "turning back to port")
            travel(leg)

            say(command(mode="depth_heading_hold"), "stopping")
            # Holding means no velocity relative to the net, which the waves never quite allow.
            still = lambda now: abs(now["data"]["velocity"]["sway_m_per_s"]) < 0.05
            say(wait_until(still), "stopped")
        except Refused as refused:
            print(refused, file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
