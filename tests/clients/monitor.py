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
    """Puts events into the order of their numbers, each once, and asks for those that are missing.

    The subscriber below recovers what was lost on the way, but an event that arrives while it still waits for the
    history makes it leave the history out. The service keeps its last events: they are asked for, again and again,
    because after a cut the way there may take a moment to be found again.
    """

    EVERY_S, QUESTIONS = 0.5, 20

    def __init__(self, vehicle, arrived):
        self.vehicle, self.arrived = vehicle, arrived
        self.next = {}  # number of the event to hand on next, by source
        self.early = {}  # events that came before their turn, by number, by source
        self.asked = {}  # how often those before them were asked for, and when again, by source

    def take(self, key, sample):
        """What to hand on now that `sample` has arrived, with its key."""
        event = message(sample)
        source, seq = event["source"], event["seq"]
        early = self.early.setdefault(source, {})
        if seq >= self.next.setdefault(source, 1):
            early[seq] = key, event
        ready = self.ready(source)
        if not early:
            self.asked.pop(source, None)
        return ready

    def ready(self, source):
        events, early = [], self.early[source]
        while (number := self.next[source]) in early:
            events.append(early.pop(number))
            self.next[source] += 1
        return events

    def look(self):
        """Asks for what is missing, if it is time to. What has been asked for in vain is given up: what to hand on."""
        events, now = [], time.monotonic()
        for source, early in self.early.items():
            times, due = self.asked.get(source, (0, now))
            if not early or now < due:
                continue
            self.asked[source] = times + 1, now + self.EVERY_S
            if times < self.QUESTIONS:
                key, _ = next(iter(early.values()))
                self.vehicle.session.get(
                    self.vehicle.key(f"{key}/@adv/**"),
                    lambda reply: reply.ok and self.arrived.put(reply.ok),
                    accept_replies=zenoh.ReplyKeyExpr.ANY,  # They come on the key of the events.
                    consolidation=zenoh.ConsolidationMode.NONE,  # All of them, not only the newest.
                    timeout=2.0,
                )
            else:
                self.next[source] = min(early)
                events += self.ready(source)
                del self.asked[source]
        return events

    def due(self):
        """When to look, if nothing arrives before."""
        return min((self.asked[source][1] for source, early in self.early.items() if early), default=float("inf"))


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

        in_order, states, key = Events(vehicle, arrived), {}, ""
        end = time.monotonic() + (arguments.seconds or float("inf"))
        try:
            while time.monotonic() < end:
                try:
                    for key, event in in_order.look():
                        show(key, event)
                    until = min(end, in_order.due())
                    left = None if until == float("inf") else max(0.0, until - time.monotonic())
                    sample = arrived.get(timeout=left)
                    key = str(sample.key_expr).removeprefix(vehicle.root + "/")
                    if key.startswith("event/"):
                        for key, event in in_order.take(key, sample):
                            show(key, event)
                    elif not key.startswith("state/"):
                        show(key, message(sample))
                    elif "/held/" not in key and not key.endswith("/now"):
                        state = message(sample)
                        if states.get(key) != state:
                            states[key] = state
                            show(key, state)
                except queue.Empty:
                    continue
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
