#!/bin/sh
# Boots a systemd of its own, for namespace.rs: process 1 of namespaces that unshare(1) has made, with the tree below
# STAGE laid over /usr and /etc. What it writes is gone with it; the machine's files are not touched.
#
#   unshare --fork --pid --mount --uts --ipc --cgroup sh boot.sh STAGE CGROUP
#
# CGROUP: the cgroup v2 directory that the caller is in.
set -eu
stage=$1
cgroup=$2

mount -t proc proc /proc
mount -t tmpfs -o mode=755 tmpfs /run
mount -t tmpfs -o mode=755 tmpfs /var/log
mount -t tmpfs -o mode=1777 tmpfs /dev/shm
# The machine's kernel log is none of its journal's business.
mount --bind /dev/null /dev/kmsg
for tree in usr etc; do
    mkdir -p "$stage/work/$tree"
    mount -t overlay overlay -o "lowerdir=/$tree,upperdir=$stage/$tree,workdir=$stage/work/$tree" "/$tree"
done
# Below whatever is mounted there: only our cgroup and its children are to be seen.
mount -t cgroup2 cgroup2 "$cgroup"
mount --move "$cgroup" /sys/fs/cgroup 2>/dev/null || mount -t cgroup2 cgroup2 /sys/fs/cgroup
mount -t tmpfs -o mode=1777 tmpfs /tmp
mount -t tmpfs -o mode=1777 tmpfs /var/tmp

# As the package's scripts do.
systemd-sysusers vpcd.conf
systemd-tmpfiles --create vpcd.conf

export container=vpcd-test
export SYSTEMD_UNIT_PATH=/etc/test-units
exec /lib/systemd/systemd --system --unit=test.target --log-target=journal --log-level=info
