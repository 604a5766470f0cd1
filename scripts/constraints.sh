#!/bin/sh
# Writes constraints.txt: the newest versions that work together, found in a clean environment.
set -eu
cd "$(dirname "$0")/.."

# The oldest supported Python decides: what still works there exists for the newer ones too.
python=${PYTHON:-python3.11}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

"$python" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --upgrade pip
"$folder/venv/bin/python" -m pip install --quiet hatchling editables
"$folder/venv/bin/python" -m pip install --quiet --no-build-isolation --editable ".[gui,notebook,formats,dev,docs]"
{
    echo "# Exact versions of everything that 'make demo', 'make test' and 'make docs' install: the extras"
    echo "# gui, notebook, formats, dev, docs, and the build tools. For Python 3.11 to 3.14. Written by"
    echo "# scripts/constraints.sh; do not edit by hand."
    "$folder/venv/bin/python" -m pip freeze --exclude-editable --exclude pip --exclude setuptools
} >"$folder/constraints.txt"
cp "$folder/constraints.txt" constraints.txt
# Has the newest Python the same packages? It need not be on this machine.
PYTHON="$folder/venv/bin/python" scripts/wheels.sh 3.14
