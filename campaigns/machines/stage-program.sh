#!/bin/bash
# stage-program.sh REPOSITORY: inside a throw-away machine, install the program into /opt/micromanip from the source tree.
#
# What `python3 -m venv /opt/micromanip; /opt/micromanip/bin/pip install REPOSITORY` does on a machine with a network:
# the program's own files are copied, the packages it needs are those of the repository's .venv.
set -eu
repository=$1
[ -e /run/throw-away-machine ] || { echo "stage-program.sh: only in a throw-away machine" >&2; exit 64; }
packages=$("${VENV:-$repository/.venv}/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
version=$(basename "$(dirname "$packages")")
/usr/bin/$version -m venv --without-pip /opt/micromanip
own=/opt/micromanip/lib/$version/site-packages
mkdir /opt/micromanip/packages
mount --bind "$packages" /opt/micromanip/packages # wherever it lies: a service does not see homes
echo /opt/micromanip/packages >"$own/packages.pth"
cp -rp "$repository/micromanip" "$repository/drivers/micromanip_drivers" "$packages"/micromanip-*.dist-info "$own"
mkdir -p /opt/micromanip/share/micromanip
cp -rp "$repository/systemd" "$repository/config" /opt/micromanip/share/micromanip
cat >/opt/micromanip/bin/micromanip <<PROGRAM
#!/opt/micromanip/bin/python
import sys
from micromanip.cli.main import main
sys.exit(main())
PROGRAM
chmod 755 /opt/micromanip/bin/micromanip
