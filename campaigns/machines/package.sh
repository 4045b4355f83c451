#!/bin/bash
# package.sh: build the Debian package and take the road of docs/your-cell.md with it on a throw-away machine; takes root.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
repository=$(cd "$here/../.." && pwd)
built=$(mktemp -d)
trap 'rm -rf "$built"' EXIT
"$repository/tools/deb/deb.sh" "${VENV:-$repository/.venv}/bin/python" "$built" >&2
"$here/ns-systemd.sh" "export PATH=/usr/sbin:/usr/bin:/sbin:/bin; '$here/own-cell.sh' '$built'/*.deb"
