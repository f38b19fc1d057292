#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Results go to the current folder. ASTRONAV names another binary.
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
astronav=${ASTRONAV:-$here/../../build/release/astronav}

[ -f orion.fits ] || "$here/../01_render_one_frame/run.sh"
"$astronav" solve orion.fits --fov 16:24 --epoch "2027-03-01T00:00:00 TDB"
"$astronav" solve orion.fits --fov 16:24 --epoch "2027-03-01T00:00:00 TDB" --json > solved.json
