#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Ten clients for a minute before one server, with others that break the rules: server_load.sh [PROGRAM] [SECONDS]
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
exec /usr/bin/python3 "$here/server_load.py" "${1:-$here/../build/release/astronav}" --seconds "${2:-60}"
