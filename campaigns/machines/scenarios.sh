#!/bin/bash
# scenarios.sh namespace|vm [FILE...]: the scenarios of tests/system, or of those files, on a throw-away machine of that
# kind; takes root.
set -eu
tier=$1
shift
here=$(cd "$(dirname "$0")" && pwd)
repository=$(cd "$here/../.." && pwd)
export VENV=${VENV:-$repository/.venv}
stage="export PATH=/usr/sbin:/usr/bin:/sbin:/bin VENV='$VENV' OPENBLAS_NUM_THREADS=1
'$here/stage-program.sh' '$repository' || exit"
pytest="cd '$repository' && PYTHONPATH=tests /opt/micromanip/bin/python -m pytest -n0 --timeout=1200 --durations=10"

case $tier in
namespace)
    # the last scenario of the second file takes the service off this machine
    exec "$here/ns-systemd.sh" "$stage
        $pytest ${*:-tests/system/gateway_scenarios.py tests/system/namespace_scenarios.py}"
    ;;
vm)
    # Compiling takes the emulated processor many minutes: it is done outside, for a processor that both can be, and
    # only once for the same sources.
    "$here/fetch-vm.sh"
    export KEPT=${VM_HOME:-${XDG_CACHE_HOME:-$HOME/.cache}/micromanip-vm}/compiled
    mkdir -p "$KEPT"
    generic="export NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES= XDG_CACHE_HOME=/kept"
    "$here/ns-systemd.sh" "$stage
        $generic
        cd /kept
        /opt/micromanip/bin/python '$repository/tests/system/vm_cell.py' cell.yaml
        /opt/micromanip/bin/micromanip device simulate cell.yaml 2>device &
        for _ in {1..600}; do grep -q READY device && break; sleep 0.5; done
        /opt/micromanip/bin/micromanip run cell.yaml --duration 1 --socket /run/control.sock
        /opt/micromanip/bin/micromanip park cell.yaml
        kill \$!; wait"
    "$here/vm.sh" "$stage
        $generic
        $pytest -s ${*:-tests/system/vm_*scenarios.py}"
    ;;
*)
    echo "scenarios.sh: namespace or vm" >&2
    exit 64
    ;;
esac
