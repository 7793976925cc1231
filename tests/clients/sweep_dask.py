#!/usr/bin/env python3
"""Spreads the runs of a sweep over a Dask cluster and joins their tables into one, with the report.

Needs `pip install distributed`, the same supertwin on every machine, and a folder that all of them share:

    python tests/clients/sweep_dask.py fair --out /shared/fair
    python tests/clients/sweep_dask.py fair --out /shared/fair --scheduler tcp://10.0.0.1:8786 --parts 64

The first starts a cluster on this machine. What it does not know, such as --set or --recordings, goes to supertwin.
Whatever went wrong, call it again: runs that are finished are not repeated.
"""

import argparse
import json
import subprocess
import sys

from distributed import Client, LocalCluster, as_completed

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("spec", metavar="SPEC", help="name in config/sweeps, or path to a sweep file")
parser.add_argument("--out", metavar="DIR", required=True, help="folder that all workers share")
parser.add_argument("--scheduler", metavar="ADDRESS", help="of a cluster that is there [default: one on this machine]")
parser.add_argument("--workers", metavar="N", type=int, default=2, help="processes of a cluster on this machine")
parser.add_argument("--parts", metavar="N", type=int, help="parts that the runs are cut into [default: two per worker]")
parser.add_argument("--supertwin", metavar="FILE", default="supertwin", help="the program, on every machine")


def call(command):
    """Runs supertwin. 1 is a verdict about runs, which stands in the table; 2 and more are failures."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"{' '.join(command)}: status {done.returncode}: {done.stderr.strip()}")
    return json.loads(done.stdout)


def main():
    arguments, others = parser.parse_known_args()
    sweep = [arguments.supertwin, "sweep", arguments.spec, "--out", arguments.out, "--json", *others]
    if arguments.scheduler:
        client = Client(arguments.scheduler)
    else:
        # A process and one thread each: supertwin is a process of its own anyway. No port is open to other machines.
        client = Client(LocalCluster(n_workers=arguments.workers, threads_per_worker=1, dashboard_address=None))
    with client:
        workers = len(client.scheduler_info(n_workers=-1)["workers"])
        parts = arguments.parts or 2 * workers
        # One core per part; a worker that vanishes costs its unfinished runs only, and its part is tried again elsewhere.
        commands = [[*sweep, "--jobs", "1", "--shard", f"{part}/{parts}"] for part in range(1, parts + 1)]
        futures = client.map(call, commands, pure=False, retries=2)
        for number, (_, part) in enumerate(as_completed(futures, with_results=True), 1):
            done = f"{part['runs']} runs, {part['done_before']} of them were finished before"
            print(f"part {part['shard']} on one of {workers} workers: {done}; {number} of {parts} parts", flush=True)
        client.cancel(futures)
    whole = call([*sweep, "--gather", arguments.out])
    print(f"{whole['runs']} runs, {whole['verdicts']}: table in {whole['table']}, report in {whole['report']}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (RuntimeError, OSError) as error:
        sys.exit(str(error))
