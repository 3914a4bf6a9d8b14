#!/bin/sh
# A systemd as first process of its own namespaces: processes, mounts, control groups, network. It sees the files of the
# machine, but where a unit writes or looks for programs there are empty folders in memory.
# Usage: root.sh SOURCE PYTHON_PREFIX PYTHON PACKAGES INTERFACE; runs itself again inside.
set -eu

case "${STAGE:-}" in
"")
    export STAGE=group
    exec unshare --mount sh "$0" "$@" # the machine's own mounts stay as they are
    ;;
group)
    group=/sys/fs/cgroup/systemd-of-tests-$$
    [ -e /sys/fs/cgroup/cgroup.procs ] || mount -t cgroup2 cgroup2 /sys/fs/cgroup
    mkdir "$group"
    trap 'sleep 0.2; find "$group" -depth -type d -exec rmdir {} +' EXIT
    STAGE=inside sh -c 'echo $$ >"$0/cgroup.procs"; exec "$@"' "$group" \
        unshare --mount --pid --cgroup --net --fork --kill-child --mount-proc sh "$0" "$@"
    exit
    ;;
esac

umount /sys/fs/cgroup
mount -t cgroup2 cgroup2 /sys/fs/cgroup # its own group is the root of what it sees
for folder in /run /var/lib /var/cache /etc/systemd /usr/lib/systemd/system /opt; do
    mount -t tmpfs tmpfs "$folder"
done
ip link set lo up
ip link add "$5" type vcan
ip link set "$5" up

mkdir -p /etc/systemd/system /opt/clutchdiag/bin /opt/source /opt/python /opt/packages
mount --bind "$1" /opt/source
mount --bind "$2" /opt/python
mount --bind "$4" /opt/packages
cat >/opt/clutchdiag/bin/diag-service <<END
#!/bin/sh
export PYTHONPATH=/opt/source:/opt/packages LD_LIBRARY_PATH=/opt/python/lib
exec /opt/python/bin/$3 -m diag_service "\$@"
END
chmod 755 /opt/clutchdiag/bin/diag-service

cp "$1/docs/deploy/clutchdiag.service" /etc/systemd/system
for target in sysinit basic shutdown network tests; do
    printf '[Unit]\nDescription=%s\nDefaultDependencies=no\n' "$target" >"/etc/systemd/system/$target.target"
done
exec /lib/systemd/systemd --system --unit=tests.target --log-target=kmsg --show-status=no
