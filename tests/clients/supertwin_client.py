"""What the other programs here have in common: a session, questions with retries, the lease, the newest message."""

import argparse
import json
import pathlib
import sys
import threading
import time
import uuid

import zenoh

# Who has not answered by then is not there: whoever is there answers at once, and on a busy machine some time.
ANSWER_S = 10


def parser(description):
    """The arguments that all programs know."""
    raw = argparse.RawDescriptionHelpFormatter
    made = argparse.ArgumentParser(description=description, formatter_class=raw)
    made.add_argument("--connect", metavar="ENDPOINT", default="unixsock-stream//tmp/supertwin/router.sock")
    made.add_argument("--credentials", metavar="DIR", help="for tls/...: the folder that supertwin pki issue made")
    made.add_argument("--vehicle", metavar="NAME", default="argus-mini")
    return made


def tls(folder):
    """Settings for TLS with the certificate and the key in a folder."""
    folder = pathlib.Path(folder).resolve()
    [key] = folder.glob("*.key")
    return {
        "enable_mtls": True,
        "root_ca_certificate": str(folder / "ca.pem"),
        "connect_certificate": str(key.with_suffix(".pem")),
        "connect_private_key": str(key),
        "close_link_on_expiration": True,
    }


class Refused(Exception):
    """The vehicle said no, and why."""


class Vehicle:
    """A vehicle on the network; `name` is what it calls this client."""

    def __init__(self, arguments, name):
        config = {
            "mode": "client",
            "connect": {
                "endpoints": [arguments.connect],
                "timeout_ms": 1000 * ANSWER_S,
                "exit_on_failure": True,
                # After a cut the session joins again by itself, soon.
                "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
            },
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        }
        if arguments.credentials:
            config["transport"] = {"link": {"tls": tls(arguments.credentials)}}
        try:
            self.session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
        except zenoh.ZError as error:
            sys.exit(f"{arguments.connect}: {error}")
        self.root = f"supertwin/{arguments.vehicle}"
        # A new name for each start: the vehicle remembers the last number of each client.
        self.client = f"{name}-{uuid.uuid4().hex[:8]}"
        self.token = ""
        self.seq = 0
        self.released = threading.Event()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.release()
        self.session.close()

    def key(self, relative):
        return f"{self.root}/{relative}"

    def ask(self, relative, body=None):
        """Asks until somebody answers; the same body every time, so that it is obeyed once however often it arrives."""
        payload = None if body is None else json.dumps(body)
        give_up = time.monotonic() + ANSWER_S
        while time.monotonic() < give_up:
            for reply in self.session.get(self.key(relative), payload=payload, timeout=0.5):
                if reply.ok:
                    return json.loads(reply.ok.payload.to_bytes())
                said = reply.err.payload.to_string()
                if said != "Timeout":
                    raise Refused(f"{relative}: {json.loads(said).get('reason', said)}")
            # When nobody is there to be asked, the question comes back at once.
            time.sleep(0.1)
        raise Refused(f"{relative}: no answer; is the vehicle up?")

    def lease(self, action, for_s):
        body = {"client": self.client, "action": action, "for_s": for_s, "token": self.token}
        return self.ask("authority/lease", body)

    def acquire(self, for_s=5.0):
        """Takes the authority and keeps it, renewed by a thread, until `release`."""
        self.token = uuid.uuid4().hex
        self.lease("acquire", for_s)

        def keep():
            # Three attempts before it runs out.
            while not self.released.wait(for_s / 3):
                try:
                    self.lease("renew", for_s)
                except Refused as refused:
                    print(f"the lease is lost: {refused}", file=sys.stderr)
                    return

        threading.Thread(target=keep, daemon=True).start()

    def release(self):
        """Gives the authority back; the vehicle goes on with what it was told."""
        self.released.set()
        if self.token:
            try:
                self.lease("release", 0.0)
            except Refused:
                pass  # It has run out before.
            self.token = ""

    def command(self, service, name, value):
        """Commands; returns the tick at which it applies."""
        self.seq += 1
        body = {"client": self.client, "seq": self.seq, "token": self.token, "value": value}
        return self.ask(f"command/{service}/{name}", body)["apply_tick"]

    def newest(self, relative):
        """A subscriber that keeps the newest message only: what is older is of no use to who steers."""
        return self.session.declare_subscriber(self.key(relative), zenoh.handlers.RingChannel(1))


def message(sample):
    """The envelope: run, source, tick, seq, sim_time_s, clock_ns, data."""

    def refuse(word):
        # Python reads NaN and Infinity, which are no JSON, and would hand them on.
        raise ValueError(f"{word} is no number")

    return json.loads(sample.payload.to_bytes(), parse_constant=refuse)
