#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The Python package installs offline into an environment of its own, and its tests pass from there.
set -euo pipefail
export ASTRONAV=$1
python=$2
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cp -r "$python" "$folder/source"  # pip builds beside its source
/usr/bin/python3 -m venv --system-site-packages "$folder/env"
"$folder/env/bin/pip" install --quiet --no-index --no-build-isolation "$folder/source"
cd "$folder"
"$folder/env/bin/python" -c "import astronav; assert '/env/lib/' in astronav.__file__, astronav.__file__"
"$folder/env/bin/python" -m unittest discover -s "$folder/source/tests" -t "$folder/source/tests"
