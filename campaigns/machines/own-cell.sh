#!/bin/bash
# own-cell.sh PACKAGE CELL: inside a throw-away machine, from the package to a service that holds a stage, and back.
#
# CELL is modbus (one axis, its gauge alone, 250 Hz), can (three axes with stage sensors and a tracker, 1 kHz) or slcan
# (one axis and its gauge behind a CAN adapter on a serial port, 100 Hz); the devices are emulated. What is typed and
# what is seen is the transcript of docs/your-cell.md. Ends with 1 at the first thing that is not as it must be.
set -u
package=$1 cell=$2
here=$(cd "$(dirname "$0")" && pwd)
[ -e /run/throw-away-machine ] || { echo "own-cell.sh: only in a throw-away machine" >&2; exit 64; }
export COLUMNS=120 PYTHONUNBUFFERED=1
unset PYTHONDONTWRITEBYTECODE

wrong() {
    echo "NOT AS IT MUST BE: $*"
    tail -n 5 device.log
    cp -r . /kept/ # for who looks into it, where KEPT names a folder
    journalctl -q --no-pager -n 40 -u micromanip
    exit 1
}
typed() { # typed CODE COMMAND...: its output, but for tables of timing, files and long lists; its exit code must be CODE
    local code=$1
    shift
    echo "\$ $*"
    "$@" >said 2>&1
    code_is=$?
    sed -e '/ Timing, us/,$d' -e '/^    [-+@]/d' -e '/\.hysteresis/d' -e '/\.outer\./d' -e '/\.coupling/d' \
        -e '/^(Reading/d' said
    [ $code_is = "$code" ] || wrong "exit code $code_is of $*, $code is right"
}
state() { micromanip status --json 2>/dev/null | /usr/bin/python3 -c 'import json, sys; print(json.load(sys.stdin)["state"])'; }
reached() { # reached STATE: within three minutes
    for _ in {1..900}; do
        [ "$(state 2>/dev/null)" = "$1" ] && return
        sleep 0.2
    done
    wrong "$(state), not $1"
}

mkdir -p /srv/cell
cd /srv/cell || exit 1
cp "$package" "$here/device.dbc" .
typed 0 dpkg -i micromanip_*.deb
[ -e /usr/lib/systemd/system/micromanip.service ] || wrong "no unit"

chosen=z device=cell.yaml centre=50 range='15, 100'
case $cell in
modbus) new=(--driver modbus --axes z --address 127.0.0.1) after='timeout_ms: 20' ;;
can) # the zero of its stage sensors is where the gauges read 66
    chosen=all new=(--driver canbus --axes x,y,z --stage --tracker) after='bitrate: 1000000' centre=66 range='2, 128'
    ;;
slcan)
    new=(--driver canbus --axes z --rate 100 --address /dev/ttyACM0) after='bitrate: 1000000' device=device.yaml
    /usr/bin/python3 "$here/null_modem.py" /dev/ttyACM0 /srv/cell/device &
    modem=$!
    ;;
*)
    echo "own-cell.sh: there is no cell $cell: modbus, can and slcan are there" >&2
    exit 64
    ;;
esac
echo "\$ micromanip new ${new[*]} > cell.yaml"
micromanip new "${new[@]}" >cell.yaml || wrong new
[ $chosen = all ] || [ "$(wc -l <cell.yaml)" -le 30 ] || wrong "more than 30 lines"
typed 78 micromanip check cell.yaml
# what a person writes: the amplifier's data sheet, and that this one is emulated
sed -i -e '/^  voltage_/s/}$/, range_V: [-20, 130], slew_V_per_ms: 10}/' \
    -e "s/^    setpoint: {}.*/    centre_um: $centre\n    setpoint: {range_um: [$range], slew_um_per_ms: 1}/" \
    -e "s/^    $after\$/    watchdog: {ms: 100, rest_ms: 250, after_power_on: rest}\n&\n    simulated: true/" \
    -e 's,database: ,&/srv/cell/,' -e 's/interface: socketcan/interface: micromanip/' -e 's/limits: hardware/limits: simulation/' cell.yaml
echo 'faults: {axis: {strain: {coast_ms: 1000}}} # this machine is shared, and stands still at times' >>cell.yaml
echo 'simulation: {force: {static_N: 0, tooth_N: 0, noise_N: 0}}' >>cell.yaml
typed 0 micromanip check cell.yaml

[ $device = cell.yaml ] || sed 's,/dev/ttyACM0,/srv/cell/device,' cell.yaml >$device
mkfifo orders
micromanip device simulate $device --commands <orders >device.log 2>&1 &
player=$!
exec 3>orders
for _ in {1..600}; do grep -q READY device.log && break; sleep 0.2; done
grep -q READY device.log || wrong "$(cat device.log)"

typed 0 micromanip system install cell.yaml --yes
[ ! -e /etc/systemd/system/micromanip.service ] || wrong "a second unit beside the package's"
typed 0 systemctl start micromanip
reached READY
typed 0 micromanip status
typed 0 systemctl stop micromanip
echo "\$ micromanip commission cell.yaml --axis $chosen --out tuned --yes"
micromanip commission cell.yaml --axis $chosen --out tuned --yes >commission.log 2>&1
code=$?
grep -A 999 -e '^axis [xz]' commission.log | grep -v -e TRACKING -e READY -e recorded -e 'us  compute' | tail -n 24
[ -e tuned/tuned.yaml ] || wrong "commission ended with $code: $(tail -n 5 commission.log)"

typed 0 systemctl start micromanip
reached READY
typed 0 micromanip apply tuned/tuned.yaml --service micromanip --yes
reached READY
typed 0 micromanip arm
reached TRACKING
[ $cell = can ] || typed 0 micromanip jog z 5 # where a tracker says where it goes, nobody else does
sleep 5
typed 0 micromanip status
[ "$(state)" = TRACKING ] || wrong "$(state) after a jog"
echo '$ echo {"device": "freeze", "signal": "strain_z", "for_s": 2}      # to the emulated device'
echo '{"device": "freeze", "signal": "strain_z", "for_s": 2}' >&3
reached FAULT
typed 0 micromanip status
sleep 2
typed 0 micromanip reset
reached READY
typed 0 micromanip apply --back --service micromanip --yes
reached READY
typed 0 micromanip status
cmp cell.yaml /etc/micromanip/cell.yaml || wrong "another file than before"

typed 0 micromanip arm
reached TRACKING
typed 1 dpkg --remove micromanip # not below a cell that holds its stage
[ "$(state)" = TRACKING ] || wrong "removing it has stopped it"
typed 0 micromanip disarm
reached READY
typed 0 dpkg --remove micromanip
[ ! -e /opt/micromanip ] || wrong "$(find /opt/micromanip | head)"
systemctl is-active -q micromanip && wrong "the service runs on"
[ -e /etc/micromanip/cell.yaml ] || wrong "the configuration went before purge"
typed 0 dpkg --purge micromanip
for each in /etc/micromanip /var/lib/micromanip /var/cache/micromanip /usr/lib/systemd/system/micromanip.service; do
    [ ! -e $each ] || wrong "$each stays"
done
getent passwd micromanip && wrong "its user stays"
exec 3>&-
wait $player
[ -z "${modem-}" ] || kill "$modem"
echo "all as it must be, $SECONDS s"
