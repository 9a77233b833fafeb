#!/usr/bin/env bash
# Library: pytest-xdist 3.8.0 with pytest 9.2.0, the newest of both that pip installs together.
# Expected: with `--dist loadgroup` all tests that carry the same `xdist_group` mark run in one worker, one after another;
#   that is what the mark is documented for, tests that share a port or a device for instance.
# Happens: they are spread over the workers as if there were no mark. Neither a warning nor an error says so. With
#   pytest 8.4.2 the same file runs in one worker.
# Matters: tests that start real routers and cars in real time disturb each other, now and then, on the machine with
#   more cores. Group by file (`--dist loadfile`), which works with both.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
cat > "$tmp/test_one_group.py" <<'PYTHON'
import os
import time

import pytest


@pytest.mark.xdist_group("the only router")
@pytest.mark.parametrize("number", range(12))
def test_that_wants_the_router_for_itself(number: int, record_property) -> None:
    time.sleep(0.1)
    record_property("worker", os.environ["PYTEST_XDIST_WORKER"])
PYTHON

workers() { # pytest's version, kind of distribution: how many workers ran tests of the group
    local venv="$tmp/$1"
    if [ ! -d "$venv" ]; then
        python3 -m venv "$venv"
        "$venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check "pytest==$1" pytest-xdist==3.8.0
    fi
    (cd "$tmp" && "$venv/bin/python" -m pytest -q -n 2 --dist "$2" -p no:cacheprovider --junit-xml "$tmp/found.xml" \
        test_one_group.py > "$tmp/said" 2>&1) || { cat "$tmp/said"; exit 1; }
    grep -o 'name="worker" value="gw[01]"' "$tmp/found.xml" | sort -u | wc -l
}

new=$(workers 9.2.0 loadgroup)
old=$(workers 8.4.2 loadgroup)
file=$(workers 9.2.0 loadfile)
echo "workers that ran one group: pytest 9.2.0 --dist loadgroup $new, pytest 8.4.2 $old; pytest 9.2.0 --dist loadfile $file"
if [ "$new $old $file" != "2 1 1" ]; then
    echo "changed: expected 2, 1 and 1" >&2
    exit 1
fi
