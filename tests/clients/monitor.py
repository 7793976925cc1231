#!/usr/bin/env python3
"""Prints what the vehicle says about itself: every event from the first one on, and each state that changes.

    python tests/clients/monitor.py --seconds 10
    python tests/clients/monitor.py --json --also 'health/*'      one JSON object per line, until Ctrl-C
"""

import json
import queue
import sys
import time

import zenoh
from zenoh.ext import HistoryConfig, RecoveryConfig, declare_advanced_subscriber

from supertwin_client import Vehicle, message, parser


class Events:
    """Puts events into the order of their numbers, each once, and asks for those that are missing."""

    def __init__(self, vehicle):
        self.vehicle = vehicle
        self.last = {}  # number of the last event that was handed on, by source

    def complete(self, sample):
        """What to hand on now that `sample` has arrived: it, and before it what is missing."""
        event = message(sample)
        next_one = self.last.get(event["source"], 0) + 1
        if event["seq"] < next_one:
            return []  # History and recovery overlap.
        events = {event["seq"]: event}
        if event["seq"] > next_one:
            # The subscriber below recovers what was lost on the way, but an event that arrives while it still waits
            # for the history makes it leave the history out. The service keeps its last events: they are asked for.
            # After a cut the way there may take a moment to be found again.
            for _ in range(10):
                replies = self.vehicle.session.get(
                    f"{sample.key_expr}/@adv/**",
                    accept_replies=zenoh.ReplyKeyExpr.ANY,  # They come on the key of the events.
                    consolidation=zenoh.ConsolidationMode.NONE,  # All of them, not only the newest.
                    timeout=2.0,
                )
                for reply in replies:
                    if reply.ok:
                        kept = message(reply.ok)
                        if kept["source"] == event["source"] and next_one <= kept["seq"]:
                            events[kept["seq"]] = kept
                if all(number in events for number in range(next_one, event["seq"])):
                    break
                time.sleep(0.2)
        self.last[event["source"]] = max(events)
        return [events[seq] for seq in sorted(events)]


def main():
    arguments = parser(__doc__)
    arguments.add_argument("--seconds", metavar="S", type=float, help="end after this long")
    arguments.add_argument("--json", action="store_true", help="one JSON object per line")
    arguments.add_argument("--also", metavar="KEY", action="append", default=[], help="more to print; may be repeated")
    arguments = arguments.parse_args()

    with Vehicle(arguments, "monitor") as vehicle:
        # Callbacks only put what arrives into the queue: who prints in a callback holds up everything that comes after.
        arrived = queue.SimpleQueue()
        # What was said before now comes as history, what was missed in a cut is asked for again, and a heartbeat tells
        # about a last one that nothing follows. The history must not be limited to fewer samples than a cut can hide.
        events = declare_advanced_subscriber(
            vehicle.session,
            vehicle.key("event/*"),
            arrived.put,
            history=HistoryConfig(detect_late_publishers=True),
            recovery=RecoveryConfig(heartbeat=True),
        )
        others = [vehicle.session.declare_subscriber(vehicle.key(key), arrived.put) for key in arguments.also]
        others.append(vehicle.session.declare_subscriber(vehicle.key("state/**"), arrived.put))
        # States change seldom: the present ones are asked for. Several services answer.
        for reply in vehicle.session.get(vehicle.key("state/**"), target=zenoh.QueryTarget.ALL, timeout=1.0):
            if reply.ok:
                arrived.put(reply.ok)

        def show(key, body):
            if arguments.json:
                print(json.dumps({"key": key, "body": body}), flush=True)
            elif key.startswith("event/"):
                data = body["data"]
                when = f"{body['sim_time_s']:8.2f} s"
                print(f"{when}  {data['service']:10} {data['severity']:8} {data['text']}", flush=True)
            else:
                print(f"{key}: {json.dumps(body)[:100]}", flush=True)

        in_order, states = Events(vehicle), {}
        end = time.monotonic() + (arguments.seconds or float("inf"))
        try:
            while time.monotonic() < end:
                try:
                    sample = arrived.get(timeout=0.2)
                except queue.Empty:
                    continue
                key = str(sample.key_expr).removeprefix(vehicle.root + "/")
                try:
                    if key.startswith("event/"):
                        for event in in_order.complete(sample):
                            show(key, event)
                    elif not key.startswith("state/"):
                        show(key, message(sample))
                    elif "/held/" not in key and not key.endswith("/now"):
                        state = message(sample)
                        if states.get(key) != state:
                            states[key] = state
                            show(key, state)
                except (ValueError, KeyError, TypeError, RecursionError) as error:
                    # Anybody can write anything on a key; a monitor must not fall over it.
                    print(f"{key}: not understood: {error!r:.200}", file=sys.stderr)
        except KeyboardInterrupt:
            pass
        # A subscriber with a callback keeps the process alive until it is undeclared.
        for subscriber in [events, *others]:
            subscriber.undeclare()
    return 0


if __name__ == "__main__":
    sys.exit(main())
