#!/bin/busybox sh
# Process 1 of the virtual machine: mount the host's / read-only under a throw-away overlay, bring vcan0 up, start systemd.
/bin/busybox mkdir -p /proc /sys /dev /low /layers /new /sbin
/bin/busybox --install -s /bin
export PATH=/bin:/sbin
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs devtmpfs /dev
while read -r module; do
    insmod "/modules/$module" || echo "no module $module"
done </modules/order
share=trans=virtio,version=9p2000.L,msize=512000
mount -t 9p -o "ro,cache=loose,$share" root /low || echo "the host's / is not there"
mount -t tmpfs layers /layers
mkdir /layers/upper /layers/scratch
mount -t overlay -o lowerdir=/low,upperdir=/layers/upper,workdir=/layers/scratch overlay /new || echo "no overlay"
mkdir -p /new/exchange /new/kept /new/lib/modules
for folder in exchange kept; do mount -t 9p -o "rw,$share" $folder /new/$folder; done
ln -s "$(cat /modules/tree)" /new/lib/modules/
for program in candump cansend cangen; do
    [ -x /new/usr/bin/$program ] || cp "/new$(cat /can-utils)/$program" /new/usr/bin/ # not every user sees where they lie
done
for tree in proc sys dev; do mount --move /$tree /new/$tree; done
mkdir -p /new/dev/pts /new/dev/shm
mount -t devpts devpts /new/dev/pts
mount -t tmpfs shm /new/dev/shm
mount -t tmpfs run /new/run
mkdir -p /new/run/lock /new/run/systemd/system
chmod 1777 /new/run/lock
touch /new/run/throw-away-machine
chroot /new /bin/sh -c 'ip link set lo up; ip link add vcan0 type vcan; ip link set vcan0 up'
for unit in systemd-tmpfiles-setup systemd-tmpfiles-setup-dev systemd-tmpfiles-clean systemd-udev-trigger systemd-udevd \
    systemd-timesyncd systemd-pstore systemd-binfmt systemd-hwdb-update systemd-update-utmp systemd-firstboot \
    modprobe@configfs modprobe@drm modprobe@efi_pstore; do
    ln -s /dev/null "/new/run/systemd/system/$unit.service" # slow, or meant for real devices
done
cat >/new/run/systemd/system/test-command.service <<'UNIT'
[Unit]
SuccessAction=reboot-force
FailureAction=reboot-force
[Service]
Type=oneshot
TimeoutStartSec=infinity
Environment=HOME=/root PYTHONDONTWRITEBYTECODE=1
ExecStart=/bin/bash -c '/bin/bash /exchange/command >/exchange/output 2>&1 </dev/null; echo $? >/exchange/status; sync'
UNIT
exec switch_root /new /lib/systemd/systemd --unit=test-command.service
