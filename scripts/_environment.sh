# Sourced by the scripts beside it (bash). Makes the Python environment .venv of this checkout when it is
# missing or out of date, and costs a few milliseconds when it is not: no pip, no python is started to find out.
#
#   $root                     the project's folder
#   ensure_environment run    what the program needs
#   ensure_environment dev    that and what the tests need
#
# Standard output is left to the program. pip's own words go to .venv-setup.log.

complain() { printf 'mavcompass: %s\n' "$*" >&2; }

root=$(cd -P "${BASH_SOURCE[0]%/*}/.." && pwd)

# What an installed environment depends on: where it stands (its scripts hold absolute paths) and what
# pyproject.toml asks for. The settings of ruff, mypy and pytest after the words cut at do not matter here.
wanted_stamp() {
    local text
    text=$(<"$root/pyproject.toml")
    stamp="$root
${text%%$'\n\n# From here on'*}"
}

stamp_is_current() { # LEVEL
    [ -f "$root/.venv/.installed-$1" ] && [ "$(<"$root/.venv/.installed-$1")" = "$stamp" ]
}

environment_is_current() { # LEVEL; an environment for the tests also runs the program
    [ -x "$root/.venv/bin/mavcompass" ] && [ -x "$root/.venv/bin/python" ] || return 1
    stamp_is_current dev || { [ "$1" = run ] && stamp_is_current run; }
}

find_python() {
    for python in python3.13 python3.12 python3.11 python3; do
        if "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then
            return
        fi
    done
    complain "no Python 3.11 or newer was found; install one" \
        "(Debian, Ubuntu: sudo apt install python3 python3-venv) and start this again."
    exit 1
}

# One set-up at a time: the lock is on the project's folder itself, through descriptor 9, and goes with the
# process that holds it however that ends.
lock_setup() {
    exec 9<"$root"
    if ! "$python" -c 'import fcntl; fcntl.flock(9, fcntl.LOCK_EX | fcntl.LOCK_NB)' 2>/dev/null; then
        complain "another start is making the environment; waiting for it ..."
        "$python" -c 'import fcntl; fcntl.flock(9, fcntl.LOCK_EX)'
    fi
}

unlock_setup() { exec 9<&-; }

# A first set-up that did not end well leaves nothing behind; a later one leaves the environment as it was.
discard_unfinished() {
    if [ -e "$root/.venv/.unfinished" ]; then
        rm -rf "$root/.venv"
    fi
}

explain_failure() {
    local log=$1 unreachable='NewConnectionError|ConnectTimeout|ReadTimeout|Read timed out|ProxyError|SSLError'
    unreachable+='|name resolution|Connection (refused|reset|aborted)|Network is unreachable|\(from versions: none\)'
    if grep -Eq 'ensurepip is not available|No module named (venv|ensurepip)' "$log"; then
        complain "this Python lacks its venv module; install it (Debian, Ubuntu: sudo apt install python3-venv)" \
            "and start this again. Details: $log"
    elif grep -Eq 'No space left on device' "$log"; then
        complain "the disk is full; about 1 GB is needed for the environment. Details: $log"
    elif grep -Eq "$unreachable" "$log"; then
        complain "the Python package index cannot be reached; connect this computer to the internet" \
            "(or point PIP_INDEX_URL at a mirror) and start this again. Details: $log"
    else
        complain "pip could not install the packages mavcompass needs; see $log, mend what it says" \
            "and start this again."
    fi
    if [ -x "$root/.venv/bin/mavcompass" ]; then
        complain "the environment of before is still there: $root/.venv/bin/mavcompass"
    fi
}

# Made for another place (the checkout was moved or copied), or cut short: of no use.
discard_useless() {
    discard_unfinished
    local level made_for
    for level in run dev; do
        if [ -f "$root/.venv/.installed-$level" ]; then
            IFS= read -r made_for <"$root/.venv/.installed-$level" || true
            if [ "$made_for" != "$root" ]; then
                rm -rf "$root/.venv"
            fi
        fi
    done
}

run_pip() { # LEVEL
    local what=.
    [ "$1" = run ] || what=".[$1]"
    cd "$root" || return
    if [ -e .venv/.unfinished ]; then "$python" -m venv .venv || return; fi
    .venv/bin/python -m pip install --disable-pip-version-check --editable "$what"
}

install_environment() { # LEVEL
    local log=$root/.venv-setup.log began=$SECONDS
    if ! { : >"$log"; } 2>/dev/null; then
        complain "cannot write to $root; run this once as its owner, or make a checkout of your own."
        exit 1
    fi
    discard_useless
    trap discard_unfinished EXIT
    trap 'exit 130' INT
    trap 'exit 143' TERM HUP
    if [ -x "$root/.venv/bin/python" ]; then
        complain "bringing the Python environment .venv up to date ..."
    else
        complain "making the Python environment .venv, once (a minute or two) ..."
        rm -rf "$root/.venv"
        mkdir "$root/.venv"
        : >"$root/.venv/.unfinished"
    fi
    if ! (run_pip "$1") >>"$log" 2>&1 </dev/null; then
        discard_unfinished
        explain_failure "$log"
        exit 1
    fi
    printf '%s\n' "$stamp" >"$root/.venv/.installed-$1"
    rm -f "$root/.venv/.unfinished"
    trap - EXIT INT TERM HUP
    complain "the environment is ready ($((SECONDS - began)) s)."
}

ensure_environment() { # run | dev
    local stamp python
    wanted_stamp
    environment_is_current "$1" && return
    find_python
    lock_setup
    environment_is_current "$1" || (install_environment "$1") || exit
    unlock_setup
}
