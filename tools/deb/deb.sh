#!/bin/bash
# deb.sh PYTHON OUT: a Debian package of the program in the folder OUT, built without a network.
#
# In /opt/micromanip it has a virtual environment of Debian's Python, with the program as its wheel installs it and the
# packages that it needs as they are in the environment of PYTHON: what was tested is what is installed.
set -eu
unset PYTHONPATH # pip would take a program found there for one that is installed
python=$1 out=$2
here=$(cd "$(dirname "$0")" && pwd)
repository=$(dirname "$(dirname "$here")")
system=/usr/bin/python3

tag='import sys; print(sys.implementation.cache_tag)'
[ "$("$python" -c "$tag")" = "$($system -c "$tag")" ] || {
    echo "deb.sh: $python is not of the version of $system, which will run it: make deb PYTHON=$system after make clean" >&2
    exit 69
}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
root=$work/root opt=$work/root/opt/micromanip

# the wheel, of what git knows; a build leaves files in its tree
mkdir "$work/source"
(cd "$repository" && git ls-files -z | xargs -0 cp --parents -t "$work/source")
"$python" -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --no-index \
    --wheel-dir "$work" "$work/source"
wheel=$(echo "$work"/micromanip-*.whl)
version=$(basename "$wheel" | cut -d- -f2)

$system -m venv --without-pip "$opt"
rm "$opt"/bin/[Aa]ctivate*
sed -i '/^command/d' "$opt/pyvenv.cfg"
"$python" -m pip --quiet --disable-pip-version-check --python "$opt/bin/python" install --no-deps --no-index --no-compile "$wheel"
"$python" "$here/requirements.py" "$opt"/lib/python3*/site-packages
sed -i "1s|.*|#!/opt/micromanip/bin/python3|" "$opt/bin/micromanip"
rm -f "$opt"/lib/python3*/site-packages/micromanip-*.dist-info/direct_url.json
mkdir -p "$root/usr/bin"
ln -s /opt/micromanip/bin/micromanip "$root/usr/bin/micromanip"

# where an administrator's own would be in /etc
for each in sysusers tmpfiles; do
    install -D -m 644 "$repository/systemd/micromanip.$each.conf" "$root/usr/lib/$each.d/micromanip.conf"
done
install -D -m 644 -t "$root/usr/lib/udev/rules.d" "$repository/systemd/90-micromanip.rules"
PYTHONPATH=$work/source "$python" - "$root/usr/lib/systemd/system" <<'UNITS'
import sys
from pathlib import Path
from micromanip.host.service.layout import PACKAGED
folder = Path(sys.argv[1])
folder.mkdir(parents=True)
for path, text in PACKAGED.files().items():
    if path.suffix == ".service":
        (folder / path.name).write_text(text, encoding="utf-8")
UNITS
install -D -m 644 "$repository/LICENSE" "$root/usr/share/doc/micromanip/copyright"
cp "$repository/CHANGELOG.md" "$root/usr/share/doc/micromanip"
find "$repository/docs" -maxdepth 1 -name '*.md' -exec install -D -m 644 -t "$root/usr/share/doc/micromanip/manual" {} +

mkdir "$root/DEBIAN"
minor=$($system -c 'import sys; print(sys.version_info.minor)')
cat >"$root/DEBIAN/control" <<CONTROL
Package: micromanip
Version: $version
Architecture: $(dpkg --print-architecture)
Maintainer: micromanip
Section: science
Priority: optional
Depends: python3 (>= 3.$minor~), python3 (<< 3.$((minor + 1))~), systemd, passwd
Installed-Size: $(du -sk --exclude=DEBIAN "$root" | cut -f1)
Description: Real-time controller for piezo-actuated micro manipulators
 It holds a machining spindle on its path, over CAN, CANopen, Modbus, serial lines, UDP or EtherCAT: the program with all
 that it needs, and a unit of systemd, which starts once /etc/micromanip/cell.yaml is there and it was enabled.
CONTROL
install -m 755 -t "$root/DEBIAN" "$here"/{preinst,postinst,prerm,postrm}
chmod -R go-w "$root" # whatever the mask of whoever builds it
mkdir -p "$out"
dpkg-deb --root-owner-group -Zzstd -z3 --build "$root" "$out/micromanip_${version}_$(dpkg --print-architecture).deb"
