#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Results go to the current folder. ASTRONAV names another binary.
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
astronav=${ASTRONAV:-$here/../../build/release/astronav}

# Built with the project's tests; else here, by its own CMakeLists.txt, in a minute or two.
program=$(dirname "$astronav")/follow_jupiter
if [ ! -x "$program" ]; then
  cmake -S "$here" -B build -G Ninja -DCMAKE_BUILD_TYPE=Release
  ninja -C build follow_jupiter
  program=$PWD/build/follow_jupiter
fi

"$astronav" serve --port 0 --json > server.json &
server=$!
trap 'kill "$server" 2>/dev/null; wait "$server" || true' EXIT
until [ -s server.json ]; do kill -0 "$server"; sleep 0.05; done
port=$(sed -E 's/.*"port":([0-9]+).*/\1/' server.json)

"$program" "$port"
