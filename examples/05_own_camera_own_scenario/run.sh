#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Results go to the current folder. ASTRONAV names another binary.
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
astronav=${ASTRONAV:-$here/../../build/release/astronav}

"$astronav" render --camera "$here/small-camera.toml" --epoch "2026-08-20T00:00:00 TDB" --observer earth \
  --pointing 84,0.5,0 --out small.fits
"$astronav" trajectory design --from earth --to venus --departure "2026-07-20T00:00:00 TDB" --days 130 --out venus.oem
"$astronav" run "$here/earth-venus.toml" --out venus
