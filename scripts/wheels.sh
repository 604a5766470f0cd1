#!/bin/sh
# Says whether every package of constraints.txt has a wheel for a Python that need not be here.
#
#   wheels.sh 3.14    resolves the pinned set for CPython 3.14 on this system and downloads it
#
# Needs an environment that pip and packaging are in: PYTHON, else python3. About 1 GB, which is
# removed again. Exit code 1 and one sentence on stderr where a wheel is missing.
set -eu
cd "$(dirname "$0")/.."

version=${1:?usage: wheels.sh VERSION, such as 3.14}
python=${PYTHON:-python3}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

"$python" - >"$folder/wanted.txt" <<'END'
import tomllib
from pathlib import Path

project = tomllib.loads(Path("pyproject.toml").read_text("utf-8"))
wanted = [*project["build-system"]["requires"], "editables", *project["project"]["dependencies"]]
for extra, packages in project["project"]["optional-dependencies"].items():
    if extra != "train":  # not pinned
        wanted += [name for name in packages if not name.startswith("pv-inspect[")]
print("\n".join(wanted))
END
platforms=$("$python" -c '
from packaging.tags import platform_tags
print(*(f"--platform {tag}" for tag in [*platform_tags(), "any"]))')

# shellcheck disable=SC2086  # one word per option
if ! "$python" -m pip --disable-pip-version-check download --quiet --no-cache-dir \
    --only-binary=:all: --python-version "$version" --implementation cp \
    --abi "cp$(echo "$version" | tr -d .)" --abi abi3 --abi none $platforms \
    --dest "$folder/wheels" --constraint constraints.txt --requirement "$folder/wanted.txt" \
    2>"$folder/said.txt"; then
    # pip first lists every version that it passed over.
    why=$(grep '^ERROR: ' "$folder/said.txt" | grep -v '^ERROR: Ignored' | head -n 1)
    echo "pv-inspect: the pinned set can't be had as wheels for Python $version: ${why#ERROR: }" >&2
    exit 1
fi
echo "Python $version: $(ls "$folder/wheels" | wc -l) wheels, all that is pinned and asked for."
