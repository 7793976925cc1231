#!/usr/bin/env python3
"""Attacks a vehicle in every way that a client can think of, and says what came of it, one JSON object per attack.

Nothing of this may change anything on the vehicle. For each attack: requests asked, refused (with a reason), left
without an answer, granted; and messages put on wires.

    python tests/clients/hostile.py --holder anna
"""

import json
import random
import sys
import time

import zenoh

from supertwin_client import Vehicle, message, parser

WIRES = [
    "plant/measurements",
    "estimator/nav",
    "guidance/reference",
    "controller/thrust",
    "controller/wrench_request",
]
SETPOINTS = ["setpoint/depth_m", "setpoint/heading_rad", "setpoint/net_distance_m", "setpoint/speed_m_per_s"]
COMMANDS = [
    ("guidance", "mode", "neutral"),
    ("guidance", "depth_m", 9.0),
    ("guidance", "direction", "port"),
    ("controller", "law", "external"),
    ("controller", "neutral", False),
    ("estimator", "restart", None),
    ("plant", "dvl_silent_for_s", 10.0),
    ("plant", "thruster_gain", {"thruster": 1, "gain": 0.0}),
]
U64 = 2**64 - 1

RANDOM = random.Random(1)
GARBAGE = [
    b"",
    b"\x00",
    RANDOM.randbytes(300),
    b"null",
    b"[]",
    b"{}",
    b'"deep"',
    b"[" * 60_000,
    b'{"a":' * 10_000,
    b'{"client":"anna","seq":-1,"token":1,"value":NaN}',
    b'{"client":"anna","seq":1e400,"token":"x","value":Infinity}',
    b'{"source":7,"tick":"now","seq":[],"data":false}',
    b'{"source":"e","tick":1,"seq":1,"data":{"depth_m":NaN}}',
    "{\u202e\u0000}".encode(),
    b"x" * 1_000_000,
]


class Attacker:
    def __init__(self, vehicle, holder):
        self.vehicle = vehicle
        self.holder = holder
        self.count = {}

    def add(self, what, n=1):
        self.count[what] = self.count.get(what, 0) + n

    def reply(self, reply):
        if reply.ok:
            self.add("granted")
            self.count.setdefault("first_granted", reply.ok.payload.to_string()[:200])
        elif (said := reply.err.payload.to_string()) == "Timeout":
            self.add("timeouts")
        else:
            self.add("refused")
            self.count.setdefault("first_refusal", said[:200])

    def ask(self, key, payload, root=None):
        """A request; the answers are counted."""
        self.add("asked")
        payload = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        for reply in self.vehicle.session.get(f"{root or self.vehicle.root}/{key}", payload=payload, timeout=30.0):
            self.reply(reply)

    def insist(self, answer, key, payload):
        """Asks until the answer is this, thirty times at most, with time for what it depends on to get through."""
        for _ in range(30):
            self.ask(key, payload)
            if self.count.get(answer):
                break
            time.sleep(0.1)

    def put(self, key, payload):
        self.add("put")
        payload = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        # An attack that is lost on its way would be none.
        self.vehicle.session.put(self.vehicle.key(key), payload, congestion_control=zenoh.CongestionControl.BLOCK)

    def request(self, value, **others):
        return {"client": self.holder, "seq": RANDOM.randint(1, U64), "token": "", "value": value, **others}

    # ------------------------------------------------------------------------------------------------- the attacks

    def garbage_requests(self):
        for payload in GARBAGE[1:]:
            for service, name, _ in COMMANDS[:4]:
                self.ask(f"command/{service}/{name}", payload)
            self.ask("param/controller/law/pid/kp/yaw", payload)
            self.ask("authority/lease", payload)
        for key in ["command/guidance/dive", "command/guidance/a/b/c", "param/guidance/no/such", "command/plant/%2e"]:
            self.ask(key, self.request(1.0))

    def garbage_on_wires(self):
        for payload in GARBAGE:
            for key in WIRES + SETPOINTS + ["state/authority/lease", "stop/plant", "witness/eve", "clock/ping"]:
                self.put(key, payload)

    def without_authority(self):
        for service, name, value in COMMANDS:
            self.ask(f"command/{service}/{name}", {"client": "eve", "seq": 1, "value": value})
            self.ask(f"param/{service}/limits/depth_m", {"client": "eve", "seq": 1, "value": [0.0, 100.0]})

    def guessed_token(self):
        for service, name, value in COMMANDS:
            for token in ["", "0" * 64, f"{RANDOM.getrandbits(256):064x}", "*", "\u0000", "' OR 1=1"]:
                self.ask(f"command/{service}/{name}", self.request(value, token=token))

    def wrong_vehicle(self):
        # Nobody is there: no answer is the right answer.
        for root in ["supertwin/nautilus", "supertwin", "nautilus", "supertwin/argus-mini/argus-mini"]:
            self.ask("command/guidance/depth_m", self.request(9.0), root=root)

    def absurd_leases(self):
        for_s = [-1, 0, 0.1, 61, 1e9, 1e308, 1e999, "long", None, [5], True]
        for value in for_s:
            self.ask("authority/lease", {"client": "eve", "action": "acquire", "for_s": value})
        for client in ["", "*", "**", "a/b", "$*", "x" * 65, "\u0000", 7, None, "eve eve"]:
            self.ask("authority/lease", {"client": client, "action": "acquire", "for_s": 5})
        for action in ["acquire", "renew", "release", "steal", ""]:
            for client in ["eve", self.holder]:
                self.ask("authority/lease", {"client": client, "action": action, "for_s": 5, "token": "guess"})

    def streams_without_authority(self):
        for key in SETPOINTS:
            for seq in range(1, 200):
                self.put(key, {"client": self.holder, "token": "guess", "seq": seq, "value": 9.0})
                self.put(key, {"client": "eve", "token": "", "seq": U64, "value": 9.0})

    def rivals(self):
        """Well-formed messages of another writer, with the vehicle's own values changed, old, new and far ahead."""
        real = {}
        for key in WIRES[:4]:
            with self.vehicle.newest(key) as subscriber:
                real[key] = message(subscriber.recv())
        bent = {key: {**envelope, "source": "eve-1"} for key, envelope in real.items()}
        bent["plant/measurements"]["data"] = {
            "dvl": None,
            "depth": {"taken_at_s": 0.0, "depth_m": 13.0},
            "compass": {"taken_at_s": 0.0, "heading_rad": 3.0},
            "gyro": None,
        }
        bent["estimator/nav"]["data"]["depth_m"] = 13.0
        bent["guidance/reference"]["data"].update(mode="neutral", depth_m=13.0)
        bent["controller/thrust"]["data"].update(emergency_neutral=True)
        seq = 0
        for step in range(100):
            seq += 1
            for key, envelope in bent.items():
                for tick in [0, envelope["tick"] + step, envelope["tick"] + step + 10, U64]:
                    for run in [envelope["run"], "", "another"]:
                        self.put(key, {**envelope, "tick": tick, "seq": seq, "run": run})
            # Half a tick: some of each tick's come before the real message and some after it.
            time.sleep(0.01)

    def deletes(self):
        for key in WIRES + SETPOINTS + [
            "state/authority/lease",
            "state/guidance/mode",
            "state/controller/parameters",
            "authority/lease",
            "event/guidance",
            "health/plant",
            "command/guidance/mode",
            "param/controller",
            "alive/plant/eve",
        ]:
            self.add("put")
            self.vehicle.session.delete(self.vehicle.key(key))

    def replays(self):
        """A client that does have the authority and is clumsy: the same number twice, older ones, other values."""
        body = {"client": self.holder, "seq": 5, "token": "guess", "value": 9.0}
        for seq in [5, 5, 4, 0, U64, U64, 1]:
            self.ask("command/guidance/depth_m", {**body, "seq": seq})

    def paced(self, times, per_s, once):
        began = time.monotonic()
        done = 0
        while done < times:
            due = (time.monotonic() - began) * per_s
            while done < min(due, times):
                once(done)
                done += 1
            # The pace of the attack, not a wait: what is due is caught up with.
            time.sleep(0.001)
        self.count["per_s"] = round(done / (time.monotonic() - began))

    def command_flood(self):
        payload = json.dumps(self.request(9.0, token="guess")).encode()
        querier = self.vehicle.session.declare_querier(self.vehicle.key("command/guidance/depth_m"), timeout=0.5)
        unread = zenoh.handlers.RingChannel(1)

        def once(_):
            self.add("asked")
            querier.get(unread, payload=payload)

        self.paced(30_000, 10_000, once)
        # And yet a question that is meant seriously gets its answer, if not at the first try: the service answers so
        # many requests between two ticks and lets the rest go.
        while not self.count.get("refused"):
            self.ask("command/guidance/depth_m", payload)

    def wire_flood(self):
        payload = [b"garbage", json.dumps({"client": "eve", "token": "", "seq": 1, "value": 9.0}).encode()]
        keys = ["plant/measurements", "setpoint/depth_m", "guidance/reference"]
        self.paced(20_000, 10_000, lambda i: self.put(keys[i % 3], payload[i % 2]))

    # ------------------------------------------- attacks that only an access list of the router can refuse; not by default

    def forged_lease(self):
        """Says in the controller's place that eve holds the authority, and commands guidance with her own token."""
        import hashlib

        forged = {
            "holder": "eve",
            "token_sha256": hashlib.sha256(b"mine").hexdigest(),
            "expires_in_s": 60.0,
            "ended": "properly",
        }
        self.put("state/authority/lease", forged)
        self.insist("granted", "command/guidance/depth_m", {"client": "eve", "seq": 1, "token": "mine", "value": 9.0})

    def forged_farewell(self):
        """Shows the holder's sign of life and takes it away again."""
        with self.vehicle.session.liveliness().declare_token(self.vehicle.key(f"alive/operator/{self.holder}")):
            # What was sent before a question has arrived with its answer.
            self.ask("authority/lease", {"client": "eve", "action": "acquire", "for_s": 5})
        self.insist("granted", "authority/lease", {"client": "eve", "action": "acquire", "for_s": 5})

    def stolen_name(self):
        """Writes in the name of guidance with the highest number there is: all that guidance writes is then old."""
        with self.vehicle.newest("guidance/reference") as subscriber:
            real = message(subscriber.recv())
        real["data"].update(mode="neutral")
        self.put("guidance/reference", {**real, "tick": real["tick"] + 1, "seq": U64})


ATTACKS = [
    "garbage_requests",
    "garbage_on_wires",
    "without_authority",
    "guessed_token",
    "wrong_vehicle",
    "absurd_leases",
    "streams_without_authority",
    "rivals",
    "deletes",
    "replays",
    "command_flood",
    "wire_flood",
]


def main():
    arguments = parser(__doc__)
    arguments.add_argument("--holder", metavar="CLIENT", default="anna", help="who has the authority")
    arguments.add_argument("--attacks", metavar="NAME,...", default=",".join(ATTACKS))
    arguments = arguments.parse_args()
    with Vehicle(arguments, "eve") as vehicle:
        for name in arguments.attacks.split(","):
            attacker = Attacker(vehicle, arguments.holder)
            getattr(attacker, name)()
            print(json.dumps({"attack": name, **attacker.count}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
