#!/usr/bin/env python3
"""Sends the vehicle to a depth and waits until it is there.

Needs only `pip install eclipse-zenoh==1.10.2` and a twin that is up:

    supertwin up --no-mission &
    python tests/clients/set_depth.py 3.0
"""

import argparse
import json
import pathlib
import queue
import sys
import time
import uuid

import zenoh

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("depth", type=float, metavar="DEPTH", help="metres below the surface")
parser.add_argument("--connect", metavar="ENDPOINT", default="unixsock-stream//tmp/supertwin/router.sock")
parser.add_argument("--credentials", metavar="DIR", help="for tls/...: the folder that supertwin pki issue made")
parser.add_argument("--vehicle", metavar="NAME", default="argus-mini")
parser.add_argument("--timeout", metavar="S", type=float, default=120.0, help="give up after this long")
arguments = parser.parse_args()

# The vehicle counts the requests of each client, and obeys a number only once. A new name starts from 1.
CLIENT = f"set-depth-{uuid.uuid4().hex[:8]}"
LEASE_S = 5.0
# Who has not answered by then is not there: whoever is there answers at once, and on a busy machine some time.
ANSWER_S = 10


def ask(session, key, body):
    """Asks until somebody answers. The body stays the same: a request that arrives twice is obeyed once."""
    give_up = time.monotonic() + ANSWER_S
    while time.monotonic() < give_up:
        for reply in session.get(f"supertwin/{arguments.vehicle}/{key}", payload=json.dumps(body), timeout=0.5):
            if reply.ok:
                return json.loads(reply.ok.payload.to_bytes())
            said = reply.err.payload.to_string()
            if said != "Timeout":
                sys.exit(f"{key}: {json.loads(said)['reason']}")
        # When nobody is there to be asked, the question comes back at once.
        time.sleep(0.1)
    sys.exit(f"{key}: no answer; is the vehicle up?")


def main():
    # A client of the router: finds nobody by itself, and fails when the router isn't there.
    config = {
        "mode": "client",
        "connect": {"endpoints": [arguments.connect], "timeout_ms": 1000 * ANSWER_S, "exit_on_failure": True},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    }
    if arguments.credentials:
        folder = pathlib.Path(arguments.credentials).resolve()
        [key] = folder.glob("*.key")
        tls = {"root_ca_certificate": str(folder / "ca.pem"), "enable_mtls": True, "close_link_on_expiration": True}
        tls |= {"connect_certificate": str(key.with_suffix(".pem")), "connect_private_key": str(key)}
        config["transport"] = {"link": {"tls": tls}}
    try:
        session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError as error:
        sys.exit(f"{arguments.connect}: {error}")
    # Estimates of the vehicle's state, as they come.
    estimates = queue.SimpleQueue()
    with session, session.declare_subscriber(f"supertwin/{arguments.vehicle}/estimator/nav", estimates.put):
        # One client commands at a time. The token proves that it is us.
        lease = {"client": CLIENT, "action": "acquire", "for_s": LEASE_S, "token": uuid.uuid4().hex}
        ask(session, "authority/lease", lease)
        try:
            order = {"client": CLIENT, "token": lease["token"]}
            ask(session, "command/guidance/mode", {**order, "seq": 1, "value": "depth_heading_hold"})
            done = ask(session, "command/guidance/depth_m", {**order, "seq": 2, "value": arguments.depth})
            print(f"accepted: {arguments.depth} m from tick {done['apply_tick']} on", flush=True)

            give_up, renew = time.monotonic() + arguments.timeout, time.monotonic() + LEASE_S / 3
            while (now := time.monotonic()) < give_up:
                if now > renew:
                    # A lease that runs out means that the operator is lost: the vehicle would stop and hold.
                    ask(session, "authority/lease", {**lease, "action": "renew"})
                    renew = now + LEASE_S / 3
                try:
                    sample = estimates.get(timeout=min(renew, give_up) - now)
                except queue.Empty:
                    continue
                message = json.loads(sample.payload.to_bytes())
                # Estimates from before the order say nothing about it.
                if message["tick"] > done["apply_tick"] and abs(message["data"]["depth_m"] - arguments.depth) < 0.2:
                    print(f"reached: {message['data']['depth_m']:.2f} m at tick {message['tick']}")
                    return 0
            print(f"not reached within {arguments.timeout:.0f} s", file=sys.stderr)
            return 1
        finally:
            # The vehicle goes on with what it was told.
            ask(session, "authority/lease", {**lease, "action": "release"})


if __name__ == "__main__":
    sys.exit(main())
