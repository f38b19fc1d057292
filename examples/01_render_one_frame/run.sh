#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Results go to the current folder. ASTRONAV names another binary.
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
astronav=${ASTRONAV:-$here/../../build/release/astronav}

"$astronav" render --camera extrema-20deg --epoch "2027-03-01T00:00:00 TDB" --observer ssb:149597870,0,0 \
  --pointing 84,0.5,0 --seed 1 --out orion.fits --truth orion.json
