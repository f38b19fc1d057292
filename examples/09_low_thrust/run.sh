#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Results go to the current folder. ASTRONAV names another binary.
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
astronav=${ASTRONAV:-$here/../../build/release/astronav}

# When is it cheap to leave for Mars?
"$astronav" trajectory porkchop --departure 2026-08-15 --step-days 5 --svg mars.svg --csv mars.csv

# A transfer by 1.9 mN on 22 kg, with coasts for navigation; flown with errors of the engine, followed by the filter.
"$astronav" trajectory low-thrust --departure "2026-11-09T00:00:00 TDB" --days 300 --out cruise.oem --plan cruise.csv
"$astronav" campaign earth-mars-low-thrust --level mil --samples 4 --out pushed \
  --set mission.trajectory_file="$PWD/cruise.oem" --set mission.thrust_plan="$PWD/cruise.csv"

# Where does it arrive, and how well is that known?
"$astronav" run earth-mars-ballistic --level mil --out coasting
"$astronav" trajectory arrival coasting/estimate.oem
