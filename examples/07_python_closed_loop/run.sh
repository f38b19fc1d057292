#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Results go to the current folder. ASTRONAV names another binary.
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
astronav=${ASTRONAV:-$here/../../build/release/astronav}

"$astronav" serve --port 0 --json > server.json &
server=$!
trap 'kill "$server" 2>/dev/null; wait "$server" || true' EXIT
until [ -s server.json ]; do kill -0 "$server"; sleep 0.05; done
port=$(sed -E 's/.*"port":([0-9]+).*/\1/' server.json)

# The package as it lies in the source tree; python/README.md tells how it is installed.
PYTHONPATH=$here/../../python /usr/bin/python3 "$here/point_at_star.py" --port "$port"
