#!/bin/busybox sh
# First program of the guest: loads the modules, lays a tmpfs over the host's root, hands over to it.
/bin/busybox mkdir -p /usr /sbin && /bin/busybox --install -s /bin
export PATH=/bin
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs devtmpfs /dev
for module in /modules/*.ko; do
  insmod "$module" || echo "guest: cannot load $module"
done
mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=loose,ro host /lower || poweroff -f
mount -t tmpfs tmpfs /upper && mkdir /upper/data /upper/work
mount -t overlay -o lowerdir=/lower,upperdir=/upper/data,workdir=/upper/work overlay /root || poweroff -f
mkdir -p /root/.guest/out
cp /guest/* /root/.guest/
mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=none,rw out /root/.guest/out || poweroff -f
for tree in dev proc sys; do mount --move /$tree /root/$tree; done

if [ -e /guest/systemd ]; then
  # The host's own enabled units, mounts and first-boot presets have no place here: start from an empty set.
  cd /root || poweroff -f
  echo c0ffee00c0ffee00c0ffee00c0ffee00 > etc/machine-id
  : > etc/fstab
  rm -f .dockerenv  # where the host is a container, the guest is none
  rm -rf etc/systemd/system usr/lib/systemd/system/*.target.wants
  mkdir -p etc/systemd/system usr/lib/systemd/system/sockets.target.wants
  ln -s ../systemd-journald.socket ../systemd-journald-dev-log.socket usr/lib/systemd/system/sockets.target.wants/
  cat > etc/systemd/system/guest.service <<'UNIT'
[Unit]
Description=The command this guest was started for
After=basic.target
Requires=basic.target
[Service]
Type=exec
ExecStart=/.guest/start
UNIT
  cd /
  exec switch_root /root /lib/systemd/systemd
fi
exec switch_root /root /.guest/start
