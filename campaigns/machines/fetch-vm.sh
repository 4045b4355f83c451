#!/bin/bash
# fetch-vm.sh: get QEMU, a PREEMPT_RT kernel and can-utils of Debian into $VM_HOME, about 90 MB; nothing is installed.
#
# What this machine has installed already (qemu-system-x86, busybox-static, kmod, can-utils) is used as it is.
set -eu
VM_HOME=${VM_HOME:-${XDG_CACHE_HOME:-$HOME/.cache}/micromanip-vm}

has_can_utils() {
    command -v candump >/dev/null || [ -x "$VM_HOME/can-utils/usr/bin/candump" ]
}

get_can_utils() { # they need nothing but the C library
    has_can_utils && return
    echo "fetch-vm.sh: can-utils" >&2
    mkdir -p "$VM_HOME/packages"
    (cd "$VM_HOME/packages" && apt-get -qq download can-utils)
    dpkg -x "$VM_HOME"/packages/can-utils_*.deb "$VM_HOME/can-utils"
    rm -r "$VM_HOME/packages"
}

[ -e "$VM_HOME/complete" ] && has_can_utils && exit 0
command -v apt-get dpkg >/dev/null || { echo "fetch-vm.sh: needs Debian's apt-get and dpkg" >&2; exit 69; }
if [ -e "$VM_HOME/complete" ]; then
    get_can_utils # fetched before they were needed
    exit
fi
kernel=$(apt-cache depends linux-image-rt-amd64 | awk '/Depends: linux-image-[0-9]/{print $2; exit}')
[ -n "$kernel" ] || { echo "fetch-vm.sh: no linux-image-rt-amd64 in the package lists: apt-get update" >&2; exit 69; }
missing=$(apt-get install --simulate --no-install-recommends qemu-system-x86 busybox-static kmod | awk '$1 == "Inst" {print $2}')

rm -rf "$VM_HOME" && mkdir -p "$VM_HOME/packages" "$VM_HOME/programs" "$VM_HOME/kernel"
echo "fetch-vm.sh: $kernel" $missing >&2
(cd "$VM_HOME/packages" && apt-get -qq download "$kernel" $missing)
for package in "$VM_HOME"/packages/*.deb; do
    case ${package##*/} in
    linux-image-*) dpkg -x "$package" "$VM_HOME/kernel" ;; # not installed: this machine boots its own
    *) dpkg -x "$package" "$VM_HOME/programs" ;;
    esac
done
rm -r "$VM_HOME/packages"
get_can_utils
if [ -x "$VM_HOME/programs/bin/kmod" ]; then
    ln -sf ../bin/kmod "$VM_HOME/programs/sbin/depmod" # its own links lead to /bin
    ln -sf ../bin/kmod "$VM_HOME/programs/sbin/modprobe"
fi
release=${kernel#linux-image-}
depmod=$(command -v depmod || echo "$VM_HOME/programs/sbin/depmod")
export LD_LIBRARY_PATH=$VM_HOME/programs/lib/x86_64-linux-gnu:$VM_HOME/programs/usr/lib/x86_64-linux-gnu
"$depmod" --basedir "$VM_HOME/kernel" "$release"
echo "$release" >"$VM_HOME/complete"
