#!/bin/bash
# vm.sh COMMAND: run it as root in a virtual machine with Debian's PREEMPT_RT kernel, systemd as process 1 and vcan0.
#
# can-utils are in its PATH, the queue discipline netem is there for whoever wants a slow bus. Its / is a throw-away
# overlay of this machine's, so that it may install, break and leave what it likes; it has no network. Ends with the
# command's exit status, 125 where there is none. `fetch-vm.sh` gets what it needs first.
# Environment: LIMIT  seconds until all of it is ended (1500)   CPUS (2)   MEMORY  in MB (2048)   VM_HOME
#              KEPT  a folder that stays, inside it is /kept
set -u
here=$(cd "$(dirname "$0")" && pwd)
export VM_HOME=${VM_HOME:-${XDG_CACHE_HOME:-$HOME/.cache}/micromanip-vm}
"$here/fetch-vm.sh" || exit
release=$(cat "$VM_HOME/complete")
programs=$VM_HOME/programs
firmware=()
find_program() { # as installed, else as fetched
    command -v "$1" || find "$programs"/{bin,sbin,usr/bin} -name "$1" 2>/dev/null | head -1
}
qemu=$(find_program qemu-system-x86_64)
busybox=$(find_program busybox)
modprobe=$(find_program modprobe)
case $qemu in "$programs"*) firmware=(-L "$programs/usr/share/qemu" -L "$programs/usr/share/seabios") ;; esac
export LD_LIBRARY_PATH=$programs/lib/x86_64-linux-gnu:$programs/usr/lib/x86_64-linux-gnu

work=$(mktemp -d "${TMPDIR:-/tmp}/micromanip-vm.XXXXXX")
machine=
clean() {
    [ -z "$machine" ] || kill "$machine" 2>/dev/null
    rm -rf "$work"
}
trap clean EXIT
trap 'exit 130' INT TERM
mkdir -p "$work/first/bin" "$work/first/modules" "$work/exchange" "$work/none"
printf '%s\n' "$1" >"$work/exchange/command"
cp "$busybox" "$work/first/bin/busybox"
install -m 755 "$here/vm-init.sh" "$work/first/init"
for module in virtio_pci 9pnet_virtio 9p overlay vcan can-raw sch_netem; do
    "$modprobe" --dirname "$VM_HOME/kernel" --set-version "$release" --show-depends $module
done | awk '$1 == "insmod" && !seen[$2]++ {print $2}' | while read -r file; do
    cp "$file" "$work/first/modules/" && basename "$file"
done >"$work/first/modules/order"
echo "$VM_HOME/kernel/lib/modules/$release" >"$work/first/modules/tree"
echo "$VM_HOME/can-utils/usr/bin" >"$work/first/can-utils"
(cd "$work/first" && find . | "$busybox" cpio -o -H newc 2>/dev/null) >"$work/initrd"

accelerator="tcg,thread=multi -cpu max" # software emulation, unless the processor really offers more
[ -w /dev/kvm ] && grep -qwE "vmx|svm" /proc/cpuinfo && accelerator="kvm -cpu host"
nice timeout -k 5 "${LIMIT:-1500}" "$qemu" "${firmware[@]}" -M q35,usb=off -accel $accelerator -smp "${CPUS:-2}" \
    -m "${MEMORY:-2048}" -nodefaults -no-user-config -display none -no-reboot -serial "file:$work/console" \
    -kernel "$VM_HOME/kernel/boot/vmlinuz-$release" -initrd "$work/initrd" \
    -append "console=ttyS0 quiet panic=-1 systemd.log_color=0 systemd.show_status=error" \
    -virtfs local,path=/,mount_tag=root,security_model=none,readonly=on,multidevs=remap \
    -virtfs "local,path=$work/exchange,mount_tag=exchange,security_model=none" \
    -virtfs "local,path=${KEPT:-$work/none},mount_tag=kept,security_model=none" -device virtio-rng-pci </dev/null &
machine=$!
wait "$machine"
ended=$?
machine=
cat "$work/exchange/output" 2>/dev/null
if [ ! -s "$work/exchange/status" ]; then
    echo "vm.sh: no result (qemu ended with $ended), the console's last lines:" >&2
    tail -25 "$work/console" >&2
    exit 125
fi
exit "$(cat "$work/exchange/status")"
