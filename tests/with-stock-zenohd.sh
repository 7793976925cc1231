#!/usr/bin/env bash
# `supertwin verify` over a stock zenohd 1.10.2 instead of our own router. Not part of CI: installing zenohd takes minutes.
#   tests/with-stock-zenohd.sh [arguments of verify]
set -euo pipefail
cd "$(dirname "$0")/.."
root=target/stock-zenohd
if ! "$root/bin/zenohd" --version 2>/dev/null | grep -q '1\.10\.2'; then
    # Unoptimised is good enough, and installs in a third of the time.
    cargo install zenohd --version =1.10.2 --locked --debug --root "$root"
fi
cargo build --release -p supertwin
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
"$root/bin/zenohd" --listen "tcp/127.0.0.1:$port" --no-multicast-scouting >/dev/null 2>&1 &
router=$!
trap 'kill "$router"' EXIT
until (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null; do kill -0 "$router"; read -rt 0.1 <> <(:) || :; done
target/release/supertwin verify --router "tcp/127.0.0.1:$port" "$@"
