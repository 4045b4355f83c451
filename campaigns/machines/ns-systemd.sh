#!/bin/bash
# ns-systemd.sh COMMAND: run it as root under a real systemd, which is process 1 of namespaces of its own.
#
# It sees a throw-away overlay of this machine's /, so that it may install, break and leave what it likes; it has no
# network and its own processes, journal and cgroups. Ends with the command's exit status, 125 where there is none.
# Environment: LIMIT  seconds until all of it is ended (1800)   KEPT  a folder that stays, inside it is /kept
set -u
[ "$(id -u)" = 0 ] || { echo "ns-systemd.sh: takes root" >&2; exit 77; }
[ -x /lib/systemd/systemd ] || { echo "ns-systemd.sh: there is no systemd here: apt-get install systemd" >&2; exit 69; }

work=$(mktemp -d "${TMPDIR:-/tmp}/micromanip-ns.XXXXXX")
mkdir "$work/exchange" "$work/layers" "$work/none"
printf '%s\n' "$1" >"$work/exchange/command"
touch "$work/exchange/console"

unified=/sys/fs/cgroup
[ -d "$unified/unified" ] && unified=$unified/unified # version 1 and 2 side by side
home_group=$unified$(awk -F: '/^0::/{print $3}' /proc/self/cgroup)
group=$unified/micromanip-test.$$

machine=
clean() {
    [ -z "$machine" ] || { kill "$machine" && wait "$machine"; } 2>/dev/null
    echo $$ >"$home_group/cgroup.procs"
    for _ in {1..50}; do # its last processes may still be about to end
        find "$group" -depth -type d -exec rmdir {} \; 2>/dev/null
        [ -d "$group" ] || break
        sleep 0.1
    done
    rm -rf --one-file-system "$work"
}
trap clean EXIT
trap 'exit 130' INT TERM
mkdir "$group" && echo $$ >"$group/cgroup.procs" || exit 125

# What follows runs inside the namespaces: build the new /, go there, become systemd.
read -r -d '' inside <<'INSIDE'
set -e
work=$1 kept=$2
mount -t tmpfs layers "$work/layers"
new=$work/layers/root
mkdir "$work/layers/upper" "$work/layers/scratch" "$new"
mount -t overlay -o "lowerdir=/,upperdir=$work/layers/upper,workdir=$work/layers/scratch" overlay "$new"
mount -t proc proc "$new/proc"
mount --bind "$new/proc/sys" "$new/proc/sys"
mount -o remount,bind,ro "$new/proc/sys" # systemd would set this machine's own sysctls
mount -t sysfs -o ro sysfs "$new/sys"
mount -t cgroup2 cgroup2 "$new/sys/fs/cgroup"
mount -t tmpfs -o mode=755 run "$new/run" # as on any machine: a client trusts no socket below a folder that all may write
mount -t tmpfs -o mode=755 dev "$new/dev"
mkdir -p "$new/dev/pts" "$new/dev/shm" "$new/exchange" "$new/run/systemd/system" "$new/run/lock"
chmod 1777 "$new/run/lock"
for node in null zero full random urandom tty; do
    touch "$new/dev/$node"
    mount --bind "/dev/$node" "$new/dev/$node"
done
mount -t devpts -o newinstance,ptmxmode=666 devpts "$new/dev/pts"
ln -s pts/ptmx "$new/dev/ptmx"
mount -t tmpfs shm "$new/dev/shm"
mkdir "$new/kept"
mount --bind "$kept" "$new/kept"
touch "$new/dev/console"
mount --bind "$work/exchange/console" "$new/dev/console"
mount --bind "$work/exchange" "$new/exchange"
for unit in tmpfiles-setup tmpfiles-setup-dev tmpfiles-clean udevd udev-trigger timesyncd; do
    ln -s /dev/null "$new/run/systemd/system/systemd-$unit.service" # they would clean /tmp, or want real devices
done
cat >"$new/run/systemd/system/test-command.service" <<'UNIT'
[Unit]
SuccessAction=exit-force
FailureAction=exit-force
[Service]
Type=oneshot
Environment=HOME=/root PYTHONDONTWRITEBYTECODE=1
StandardOutput=file:/exchange/output
StandardError=inherit
ExecStart=/bin/bash /exchange/command
UNIT
touch "$new/run/throw-away-machine"
cd "$new"
mkdir -p .old
pivot_root . .old
umount -l .old
exec env -i container=other "PATH=$PATH" /lib/systemd/systemd --system --unit=test-command.service --show-status=no
INSIDE

timeout -k 5 "${LIMIT:-1800}" unshare --fork --pid --mount --uts --ipc --net --cgroup --kill-child --propagation private \
    /bin/bash -c "$inside" - "$work" "${KEPT:-$work/none}" >/dev/null 2>"$work/errors" &
machine=$!
wait "$machine"
status=$?
machine=
if [ -e "$work/exchange/output" ]; then
    cat "$work/exchange/output"
    [ $status = 124 ] && echo "ns-systemd.sh: ended after ${LIMIT:-1800} s" >&2
else
    cat "$work/errors" "$work/exchange/console" >&2
    status=125
fi
exit $status
