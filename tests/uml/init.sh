#!/bin/sh
# First process of the User-Mode Linux guest: brings up vcan0, runs the job, hands its exit status out, halts.
# It runs as a copy in a folder of the host that also holds job.sh and receives the status.
# Lines that begin with the marker tell the launcher where the job's own output begins and ends.
PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
export PATH
job=$(dirname "$0")
marker=$(cat "$job/marker")

finish() {
    echo "$1" >"$job/status"
    sync
    halt -f -p
}

mount -t proc proc /proc && mount -t sysfs sys /sys && mount -t tmpfs tmpfs /run || finish 125
[ -c /dev/console ] || mount -t devtmpfs devtmpfs /dev || finish 125
mkdir -p /dev/shm /dev/pts
mount -t tmpfs tmpfs /dev/shm && mount -t devpts devpts /dev/pts || finish 125
ln -sfn /proc/self/fd /dev/fd
hostname vcan-guest

modules=/usr/lib/uml/modules/$(uname -r)/kernel
for module in net/can/can net/can/can-raw drivers/net/can/dev/can-dev drivers/net/can/vcan net/can/can-bcm; do
    insmod "$modules/$module.ko" || finish 125
done
ip link set lo up && ip link add vcan0 type vcan && ip link set vcan0 up || finish 125

# The job writes to a pipe, not to the console: it must not take its output for a terminal.
stty -opost </dev/console
mkfifo /run/output
cat /run/output >/dev/console &
copier=$!
echo "$marker begin $(uname -r)"
setsid -w sh "$job/job.sh" </dev/null >/run/output 2>&1
status=$?
# A process that the job left behind may hold the pipe: wait for it two seconds, no longer.
for _ in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
    kill -0 "$copier" 2>/dev/null || break
    sleep 0.1
done
echo "$marker end"
finish "$status"
