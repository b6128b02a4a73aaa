#!/usr/bin/env bash
# Every extra by itself: a fresh environment with one extra and pytest, in which that extra's tests have to pass.
#
#     tests/frameworks/extras.sh                   all, one after the other
#     tests/frameworks/extras.sh torchrl minari    some
#
# PYTHON names the interpreter, TORCH what is asked of pip first where an extra needs PyTorch.

set -uo pipefail
root=$(cd "$(dirname "$0")/../.." && pwd)
python=${PYTHON:-python3}
torch=${TORCH:-torch==2.13.0}

# extra | modules that it has to bring | its tests
extras="
core||tests/envs/test_vector.py tests/detectors/test_lagged.py
    tests/test_packaging.py::test_the_core_works_without_any_extra
render|matplotlib moviepy|tests/replay
replay|matplotlib rerun|tests/replay
multiagent|pettingzoo|tests/multiagent
ray|ray|tests/evaluation
torch|torch|tests/frameworks tests/detectors/gassl tests/detectors/mc_gassl tests/detectors/test_policy_detector.py
rl|stable_baselines3 sb3_contrib matplotlib|tests/frameworks tests/detectors/test_policy_detector.py
torchrl|torchrl tensordict pettingzoo|tests/frameworks
benchmarl|benchmarl torchrl pettingzoo|tests/frameworks
tianshou|tianshou|tests/frameworks
minari|minari h5py torch|tests/frameworks
"
foreign="benchmarl matplotlib minari pettingzoo ray rerun sb3_contrib stable_baselines3 tensordict tianshou torch torchrl"

# field NAME 2|3: the modules or the tests of an extra
field() {
    awk -F'|' -v name="$1" -v field="$2" '
        NF == 3 { here = $1 == name; if (here) printf "%s ", $field; next }
        here && field == 3 { printf "%s ", $0 }' <<<"$extras"
}

# try NAME FOLDER: install and test, everything that is said goes to standard output
try() {
    local name=$1 bin=$2/venv/bin wanted=".[$1]" tests=()
    [[ $name == core ]] && wanted=.
    "$python" -m venv "$2/venv" || return
    if grep -q "^$name = .*\"torch>=" "$root/pyproject.toml"; then
        "$bin/pip" install --quiet "$torch" || return
    fi
    (cd "$root" && "$bin/pip" install --quiet "$wanted" pytest hypothesis) || return
    for module in $(field "$name" 2); do
        "$bin/python" -c "import $module" || return
    done
    if [[ $name == core ]]; then
        "$bin/python" - $foreign <<'END' || return
import sys
from importlib.util import find_spec
here = [name for name in sys.argv[1:] if find_spec(name)]
sys.exit(f"an extra is installed: {here}" if here else 0)
END
    fi
    for path in $(field "$name" 3); do tests+=("$root/$path"); done
    (cd "$2" && "$bin/python" -m pytest -c "$root/pyproject.toml" -p no:cacheprovider "${tests[@]}")
}

failed=0
[[ $# -gt 0 ]] || set -- $(awk -F'|' 'NF == 3 { print $1 }' <<<"$extras")
for name in "$@"; do
    [[ -n $(field "$name" 3) ]] || { echo "$name is no extra with tests of its own" >&2; exit 2; }
    folder=$(mktemp -d)
    started=$SECONDS
    if try "$name" "$folder" >"$folder/log" 2>&1; then
        result="passed  $(tail -n 1 "$folder/log")"
    else
        result=FAILED
        failed=1
        cat "$folder/log" >&2
    fi
    printf '%-11s %s  (%d s)\n' "$name" "$result" $((SECONDS - started))
    rm -rf "$folder"
done
exit "$failed"
