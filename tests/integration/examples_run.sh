#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Every example runs, from a folder of its own, ends well and leaves what its page promises.
set -euo pipefail
export ASTRONAV=$1
examples=$2
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

declare -A leaves=(
  [01_render_one_frame]="orion.fits orion.json"
  [02_solve_an_image]="orion.fits solved.json"
  [03_where_is_mars]=""
  [04_fly_a_mission]="first/report.html first/estimate.oem sights/summary.json again/summary.json"
  [05_own_camera_own_scenario]="small.fits venus.oem venus/report.html"
  [06_small_campaign]="ten/report.html ten/samples.csv"
  [07_python_closed_loop]="loop.csv"
  [08_cpp_client]="loop.csv"
  [09_low_thrust]="mars.svg mars.csv cruise.oem cruise.csv pushed/report.html coasting/estimate.oem"
)
for script in "$examples"/*/run.sh; do
  name=$(basename "$(dirname "$script")")
  [ -v "leaves[$name]" ] || { echo "$name is not known to this test"; exit 1; }
  mkdir "$folder/$name"
  cd "$folder/$name"
  "$script" > "$folder/said" 2>&1 || { echo "$name failed:"; tail -20 "$folder/said"; exit 1; }
  for file in ${leaves[$name]}; do [ -s "$file" ] || { echo "$name left no $file"; exit 1; }; done
  [ -s "$folder/said" ] || { echo "$name said nothing"; exit 1; }
  echo "$name: done after $SECONDS s"
done
grep -q '"status":"solved"' "$folder/02_solve_an_image/solved.json"
[ "$(grep -c flown "$folder/06_small_campaign/ten/samples.csv")" = 12 ]
