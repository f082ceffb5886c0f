#!/bin/sh
# Installs a package in a fresh Debian, simulates and replays a drive with it, and purges it:
#   sudo tools/try_deb.sh dist/canest_0.1.0_amd64.deb [RELEASE]
# It needs root, mmdebstrap and the network, and takes about a minute. No service manager runs in it.
set -eu
package=$(realpath "$1")
release=${2:-$(. /etc/os-release && echo "$VERSION_CODENAME")}
name=/root/$(basename "$package")
exec mmdebstrap --variant=apt --include=ca-certificates \
  --customize-hook="copy-in $package /root" \
  --customize-hook="chroot \"\$1\" apt-get install -y --no-install-recommends $name" \
  --customize-hook='chroot "$1" sh -euxc "
    cd /tmp
    canest -V
    canest simulate hill-11.8-percent -o drives/
    canest replay drives/hill-11.8-percent.log -c drives/hill-11.8-percent.yaml --truth auto -o est.csv
    test -s est.csv
    test -s /usr/share/man/man1/canest-replay.1.gz
    test -s /usr/share/bash-completion/completions/canest
    test -e /usr/lib/systemd/system/canest@.service
    test -z \"\$(find /etc/systemd /var/lib/systemd -name \"canest@*\")\"
    apt-get purge -y canest
    test ! -e /usr/lib/canest
    test ! -e /etc/canest
  "' \
  "$release" /dev/null
