#!/bin/bash
# package.sh [CELL...]: build the Debian package and take the road of docs/your-cell.md with it, for each of the cells
# of own-cell.sh on a throw-away machine of its own; takes root.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
repository=$(cd "$here/../.." && pwd)
built=$(mktemp -d)
trap 'rm -rf "$built"' EXIT
"$repository/tools/deb/deb.sh" "${VENV:-$repository/.venv}/bin/python" "$built" >&2
[ $# -gt 0 ] || set -- modbus slcan can
for cell; do
    LIMIT=5400 "$here/ns-systemd.sh" "export PATH=/usr/sbin:/usr/bin:/sbin:/bin; '$here/own-cell.sh' '$built'/*.deb $cell"
done
