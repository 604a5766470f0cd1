#!/bin/sh
# Brings a fresh machine to the point where the project runs. Used by the Makefile.
#
#   bootstrap.sh python            .venv with the pinned packages and the project, editable
#   bootstrap.sh docs              what `make docs` builds the site with, into the same .venv
#   bootstrap.sh libraries SET     the system libraries of SET that are missing, where it may:
#                                  offscreen (Qt without a window), window (Qt under X11),
#                                  xvfb (window, and a virtual screen with software OpenGL)
#
# Exit code 1 and one sentence on stderr that says what to do where it can't.
set -eu
cd "$(dirname "$0")/.."

VENV=.venv
# No upper bound: what is newer is tried, and pip says which package has no wheel for it.
SUPPORTED='sys.version_info[:2] >= (3, 11)'

fail() {
    echo "pv-inspect: $*" >&2
    exit 1
}

# Prints how to run apt-get without a question being asked; fails where that is not possible.
apt_get() {
    command -v apt-get >/dev/null 2>&1 || return 1
    if [ "$(id -u)" = 0 ]; then
        echo "env DEBIAN_FRONTEND=noninteractive apt-get"
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        echo "sudo -n env DEBIAN_FRONTEND=noninteractive apt-get"
    else
        return 1
    fi
}

# install PACKAGE...: fails, without a word, where it is not allowed or does not work.
install() {
    apt=$(apt_get) || return 1
    echo "Installing system packages: $*"
    $apt update -qq && $apt install -y -qq --no-install-recommends "$@" >/dev/null
}

# Prints a Python of a supported version, preferably one that can make an environment.
find_python() {
    for name in python3.13 python3.12 python3.11 python3.14 python3; do
        # A name on the PATH may be a shim for a version that is not there: ask it.
        "$name" -c "import sys; sys.exit(not $SUPPORTED)" >/dev/null 2>&1 || continue
        python=$name
        "$name" -c 'import ensurepip, venv' >/dev/null 2>&1 && break
    done
    echo "${python-}"
}

make_venv() {
    python=$(find_python)
    [ -n "$python" ] || fail "no Python 3.11 or newer was found on the PATH: install one, such as 3.13."
    if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
        package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
        install "$package" || fail "$python can't make virtual environments, run: sudo apt-get install $package"
    fi
    echo "Making $VENV with $("$python" --version)"
    rm -rf "$VENV"
    "$python" -m venv "$VENV"
}

setup_python() {
    "$VENV/bin/python" -c "import sys, pip; sys.exit(not $SUPPORTED)" >/dev/null 2>&1 || make_venv
    echo "Installing the pinned packages into $VENV: about 1 GB, a few minutes"
    # The build tools are pinned as well, so the project is built without an environment of its own.
    pip_install hatchling editables
    pip_install --no-build-isolation --editable ".[gui,notebook,formats,dev]"
}

setup_docs() {
    pip_install --no-build-isolation --editable ".[docs]"
}

pip_install() {
    "$VENV/bin/python" -m pip --disable-pip-version-check install --quiet --constraint constraints.txt "$@"
}

# What Qt and OpenGL load at run time: "library Debian-package". PySide6 brings the rest.
OFFSCREEN="
libfontconfig.so.1      libfontconfig1
libGL.so.1              libgl1
libEGL.so.1             libegl1
libglib-2.0.so.0        libglib2.0-0
libxkbcommon.so.0       libxkbcommon0
libdbus-1.so.3          libdbus-1-3"
WINDOW="$OFFSCREEN
libxcb-cursor.so.0      libxcb-cursor0
libxcb-icccm.so.4       libxcb-icccm4
libxcb-keysyms.so.1     libxcb-keysyms1
libxcb-shape.so.0       libxcb-shape0
libxcb-xkb.so.1         libxcb-xkb1
libxkbcommon-x11.so.0   libxkbcommon-x11-0"
XVFB="$WINDOW
libGLX_mesa.so.0        libgl1-mesa-dri
Xvfb                    xvfb
xvfb-run                xvfb
xauth                   xauth"

# missing SET: Debian packages of what this machine does not have.
missing() {
    known=$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p)
    echo "$1" | while read -r thing package; do
        case $thing in
        '') ;;
        lib*) echo "$known" | grep -qF "$thing " || echo "$package" ;;
        *) command -v "$thing" >/dev/null 2>&1 || echo "$package" ;;
        esac
    done | sort -u | tr '\n' ' '
}

setup_libraries() {
    [ "$(uname -s)" = Linux ] || return 0
    case $1 in
    offscreen) things=$OFFSCREEN ;;
    window) things=$WINDOW ;;
    xvfb) things=$XVFB ;;
    *) fail "there is no set of libraries '$1': use offscreen, window or xvfb." ;;
    esac
    packages=$(missing "$things")
    [ -n "$packages" ] || return 0
    # shellcheck disable=SC2086  # one word per package
    if install $packages; then
        packages=$(missing "$things")
        [ -n "$packages" ] || return 0
    fi
    if command -v apt-get >/dev/null 2>&1; then
        fail "system packages are missing, run: sudo apt-get install ${packages% }"
    fi
    fail "system libraries are missing, install what Debian calls: ${packages% }"
}

case ${1-} in
python) setup_python ;;
docs) setup_docs ;;
libraries) setup_libraries "${2-}" ;;
*) fail "usage: bootstrap.sh python | docs | libraries SET" ;;
esac
