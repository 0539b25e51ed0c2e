#!/bin/sh
# Boots a systemd of its own, for machine.rs: process 1 of namespaces that unshare(1) has made, with the trees below
# STAGE laid over /usr, /etc and /var, and the units of STAGE/units in place of the machine's. What it writes is gone
# with it; the machine's files are not touched.
#
#   unshare --fork --pid --mount --uts --ipc --cgroup sh boot.sh STAGE CGROUP
#
# CGROUP: the cgroup v2 directory that the caller is in.
set -eu
stage=$1
cgroup=$2

mount -t proc proc /proc
mount -t tmpfs -o mode=755 tmpfs /run
mount -t tmpfs -o mode=1777 tmpfs /dev/shm
# The machine's kernel log is none of its journal's business.
mount --bind /dev/null /dev/kmsg
for tree in usr etc var; do
    mkdir -p "$stage/work/$tree"
    mount -t overlay overlay -o "lowerdir=/$tree,upperdir=$stage/$tree,workdir=$stage/work/$tree" "/$tree"
done
mount -t tmpfs -o mode=755 tmpfs /var/log
# The machine's units would all be started; those that are installed later find their places.
mount -t tmpfs -o mode=755 tmpfs /etc/systemd/system
mount -t tmpfs -o mode=755 tmpfs /usr/lib/systemd/system
cp -r "$stage/units/." /usr/lib/systemd/system
# Images for containers forbid packages to start and stop services.
rm -f /usr/sbin/policy-rc.d
# Below whatever is mounted there: only our cgroup and its children are to be seen.
mount -t cgroup2 cgroup2 "$cgroup"
mount --move "$cgroup" /sys/fs/cgroup 2>/dev/null || mount -t cgroup2 cgroup2 /sys/fs/cgroup
mount -t tmpfs -o mode=1777 tmpfs /tmp
mount -t tmpfs -o mode=1777 tmpfs /var/tmp

export container=vpcd-test
export SYSTEMD_UNIT_PATH=/etc/systemd/system:/usr/lib/systemd/system
exec /lib/systemd/systemd --system --unit=test.target --log-target=journal --log-level=info
