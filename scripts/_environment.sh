# Sourced by the scripts beside it (bash). Makes the Python environment .venv of this checkout when it is
# missing or out of date, and costs a few milliseconds when it is not: no pip, no python is started to find out.
#
#   $root                     the project's folder
#   ensure_environment all    everything that the README shows
#   ensure_environment dev    that and what the tests need
#
# Standard output is left to the program. What uv or pip say goes to .venv-setup.log.

root=$(cd -P "${BASH_SOURCE[0]%/*}/.." && pwd)
setup_log=$root/.venv-setup.log

complain() { printf 'mavcompass: %s\n' "$*" >&2; }

# The stamp of an environment: where it stands (its scripts hold absolute paths), what pyproject.toml asks for,
# and the locks, which name each release of it with its hash. An environment for the tests also runs the program.
is_current() { # EXTRA
    local made_with
    [ -x "$root/.venv/bin/mavcompass" ] && [ -f "$root/.venv/.installed" ] || return 1
    made_with=$(<"$root/.venv/.installed")
    [ "$made_with" = "dev $stamp" ] || [ "$made_with" = "$1 $stamp" ]
}

find_python() {
    for python in python3.13 python3.12 python3.11 python3; do
        if "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then return; fi
    done
    python='>=3.11' # for uv, which brings its own
    command -v uv >/dev/null && return
    complain "no Python 3.11 or newer was found; install one (Debian, Ubuntu: sudo apt install python3" \
        "python3-venv), or uv, which brings its own (https://docs.astral.sh/uv), and start this again."
    exit 1
}

install_with_uv() { # EXTRA
    command -v uv >/dev/null || return
    [ -x .venv/bin/python ] || uv venv --allow-existing --python "$python" .venv || return
    uv pip install --python .venv/bin/python --require-hashes -r "scripts/lock/$1.txt" &&
        uv pip install --python .venv/bin/python --no-deps --no-build-isolation --editable .
}

install_with_pip() { # EXTRA; most modules are never used, and not to compile them spares a third of the time
    [ -x .venv/bin/pip ] || "$python" -m venv .venv || return
    local pip=".venv/bin/python -m pip install --disable-pip-version-check --no-compile"
    $pip --require-hashes -r "scripts/lock/$1.txt" && $pip --no-deps --no-build-isolation --editable .
}

# Where starts may not write (PYTHONDONTWRITEBYTECODE, another owner) each would compile these anew.
compile_often_used() {
    .venv/bin/python -m compileall -q -j 0 -x '/tests/' mavcompass .venv/lib/python3*/site-packages/{numpy,scipy} || true
}

explain_failure() {
    local unreachable='NewConnectionError|ConnectTimeout|ReadTimeout|Read timed out|ProxyError|SSLError|dns error'
    unreachable+='|name resolution|Connection (refused|reset|aborted)|Network is unreachable|\(from versions: none\)'
    if grep -Eq 'No space left on device' "$setup_log"; then
        complain "the disk is full; about 1 GB is needed for the environment. Details: $setup_log"
    elif grep -Eq 'ensurepip is not available|No module named (venv|ensurepip)' "$setup_log"; then
        complain "this Python lacks its venv module; install it (Debian, Ubuntu: sudo apt install python3-venv)" \
            "and start this again. Details: $setup_log"
    elif grep -Eq "$unreachable" "$setup_log"; then
        complain "the Python package index cannot be reached; connect this computer to the internet" \
            "(or point PIP_INDEX_URL at a mirror) and start this again. Details: $setup_log"
    else
        complain "the packages mavcompass needs could not be installed; see $setup_log, mend what it says" \
            "and start this again."
    fi
}

make_environment() { # EXTRA
    local venv=$root/.venv began=$SECONDS other_place
    if ! { : >"$setup_log"; } 2>/dev/null; then
        complain "cannot write to $root; run this once as its owner, or make a checkout of your own."
        exit 1
    fi
    # Cut short, or made where this checkout stood before: of no use.
    other_place=$(sed -n '1{s/^[a-z]* //;p}' "$venv/.installed" 2>/dev/null || true)
    if [ -e "$venv/.unfinished" ] || [ "${other_place:-$root}" != "$root" ]; then rm -rf "$venv"; fi
    if [ -x "$venv/bin/python" ]; then
        complain "bringing the Python environment .venv up to date ..."
    else
        complain "making the Python environment .venv, once (a minute at most) ..."
        mkdir -p "$venv" && : >"$venv/.unfinished"
    fi
    trap 'exit 130' INT
    if ! (cd "$root" && { install_with_uv "$1" || install_with_pip "$1"; } && compile_often_used) \
        >>"$setup_log" 2>&1 </dev/null; then
        explain_failure
        if [ -e "$venv/.unfinished" ]; then
            rm -rf "$venv"
        else
            complain "the environment of before is still there: $venv/bin/mavcompass"
        fi
        exit 1
    fi
    printf '%s %s\n' "$1" "$stamp" >"$venv/.installed"
    rm -f "$venv/.unfinished"
    trap - INT
    complain "the environment is ready ($((SECONDS - began)) s)."
}

ensure_environment() { # all | dev
    local stamp python lock
    stamp=$(<"$root/pyproject.toml")
    stamp="$root
${stamp%%$'\n\n# From here on'*}" # below: the settings of ruff, mypy and pytest
    for lock in all dev; do
        IFS= read -r lock <"$root/scripts/lock/$lock.txt" # its own checksum
        stamp="$stamp
$lock"
    done
    is_current "$1" && return
    find_python
    exec 9<"$root" # one set-up at a time: the lock goes with the process that holds it, however that ends
    if command -v flock >/dev/null && ! flock --nonblock 9; then
        complain "another start is making the environment; waiting for it ..."
        flock 9
    fi
    is_current "$1" || make_environment "$1"
    exec 9<&-
}
