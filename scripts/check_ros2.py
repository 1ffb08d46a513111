#!/usr/bin/env python3
"""Runs `dermis run --ros2` and compares what Eclipse Cyclone DDS receives with the lines that dermis prints.

    check_ros2.py DERMIS                       a dermis built with the feature ros2
    check_ros2.py DERMIS --throughput          measures CPU, drops and latency instead (see docs/src/ros2.md)

Needs cyclonedds, rosbags and numpy from PyPI. Everything goes over the loopback interface, in a domain that depends on
the process, and needs no multicast. Ends with status 1 and a message at the first failure, and with status 77 if this
machine can't exchange messages over loopback.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
# Up to 101 a domain's ports are below those that Linux gives to clients; low numbers are used by robots.
DOMAIN = 40 + os.getpid() % 60
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
os.environ["ROS_LOCALHOST_ONLY"] = "1"
os.environ["CYCLONEDDS_URI"] = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex><Peers>
<Peer address="localhost"/></Peers></Discovery></Domain></CycloneDDS>"""

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import ros2_types

TYPES = ros2_types.Types()
LATCHED = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.Volatile, Policy.History.KeepLast(5000))
SENSOR = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(5000))
UNREACHABLE = 77
RATE = 40.0


def require(condition, message):
    if not condition:
        sys.exit(f"check_ros2: {message}")


def stamp_ns(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


class Listener:
    """Readers of several topics, and everything that they have received."""

    def __init__(self, participant):
        self.participant, self.readers, self.found = participant, {}, {}

    def add(self, topic, kind, qos):
        kind = TYPES[kind] if isinstance(kind, str) else kind
        dds = "ros_discovery_info" if topic == "ros_discovery_info" else f"rt{topic}"
        self.readers[topic] = DataReader(self.participant, Topic(self.participant, dds, kind), qos=qos)
        self.found[topic] = []
        return self

    def listen(self, until, seconds):
        """Takes messages until a condition holds; false if it doesn't in time."""
        end = time.monotonic() + seconds
        while not until():
            if time.monotonic() > end:
                return False
            for topic, reader in self.readers.items():
                self.found[topic].extend(sample for sample in reader.take(1000) if sample.sample_info.valid_data)
            time.sleep(0.005)
        return True


class Dermis:
    """A running `dermis run --ros2`, whose lines are read by a thread."""

    def __init__(self, program, *arguments, folder=None):
        command = [program, "run", *arguments, "--headless"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder)
        self.lines, self.errors = [], []
        self.threads = [threading.Thread(target=self.read, args=pair, daemon=True) for pair in (
            (self.process.stdout, lambda line: self.lines.append(json.loads(line))), (self.process.stderr, self.errors.append))]
        [thread.start() for thread in self.threads]

    @staticmethod
    def read(pipe, take):
        for line in pipe:
            take(line)

    def frames(self, patch=None):
        """The lines of frames, by their numbers."""
        found = [line for line in list(self.lines) if "sequence" in line and line.get("patch") == patch]
        return {line["sequence"]: line for line in found}

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        status = self.process.wait(30)
        [thread.join(10) for thread in self.threads]
        said = "".join(self.errors)
        require(status == 0, f"dermis ended with {status}: {said}")
        return said


def check_definitions():
    own = {name.rsplit("/", 1)[1] for name in ros2_types.own_types()}
    require(own == ros2_types.listed_types(), f"the ROS package lists other messages than {sorted(own)}")
    print(f"definitions: {len(own)} messages")


def check_refusals(program):
    for arguments, variables, text in (
        (["--ros2=healing-square"], {}, "expected letters, digits and _ (healing_square)"),
        (["--ros2=robot/skin"], {}, "expected a / in front of the namespace"),
        (["--ros2"], {"ROS_DOMAIN_ID": "233"}, 'ROS_DOMAIN_ID="233": expected a number from 0 to 232'),
        (["--ros2", "--ros2-clouds-per-s=-1"], {}, "expected 0 or a positive number"),
    ):
        done = subprocess.run([program, "run", "healing-square", "--headless", *arguments], env={**os.environ, **variables},
                              capture_output=True, text=True, timeout=60)
        require(done.returncode in (1, 2) and text in done.stderr, f"{arguments} {variables}: {done.returncode} {done.stderr}")
        require("panicked" not in done.stderr, done.stderr)
    print("refusals: 4")


def check_shape(late, patch, cloud):
    """The latched description, and a cloud of the same cells."""
    cells = len(patch.pixels)
    require(repr(late) == repr(patch), "a late joiner gets another description")
    require({len(patch.positions), len(patch.normals), len(patch.areas), len(patch.sigmas)} == {cells}, "lengths of lists")
    area = sum(patch.areas)
    require(abs(area / (0.150 * 0.060) - 1) < 1e-2, f"area of the pad: {area} m^2")
    require(all(abs(normal.z - 1) < 1e-6 for normal in patch.normals), "normals of a flat skin")
    require(patch.skin == "gel-pad" and patch.link == "forearm" and patch.header.frame_id == "gel-pad", "names")
    require((patch.quantity, patch.unit, patch.force_from) == ("relative conductivity change", "", "law"), "quantities")
    require((patch.guard_force_n, patch.baseline, patch.baseline_frames) == (0.5, "tare", 32), "limits and baseline")
    require(np.all(np.isfinite(patch.sigmas)) and max(patch.sigmas) > 0, "noise of the cells")
    require([field.name for field in cloud.fields] == ["x", "y", "z", "nx", "ny", "nz", "pressure", "sigma"], "fields of the cloud")
    points = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 8)
    require(len(points) == cloud.width == cells, "points of the cloud")
    places = np.array([[p.x, p.y, p.z] for p in patch.positions], "f4")
    require(np.array_equal(points[:, :3], places) and np.array_equal(points[:, 7], np.array(patch.sigmas, "f4")), "cells of the cloud")
    return points


def check_skin(program):
    with tempfile.TemporaryDirectory() as folder:
        text = (ROOT / "skins/examples/gel-pad.toml").read_text()
        # The 32 frames of a tare then fit between two presses of the demonstration.
        text = text.replace("frames_per_s = 25.0", f"frames_per_s = {RATE}")
        text += '\n[guard]\nforce_n = 0.5\n\n[mount]\nlink = "forearm"\nxyz_mm = [10, 20, 30]\nrpy_deg = [0, 0, 90]\n'
        skin = Path(folder) / "gel-pad.toml"
        skin.write_text(text)
        run = Dermis(program, str(skin), "--ros2=/robot/pad", "--ros2-clouds-per-s=5")
        participant = DomainParticipant(DOMAIN)
        name = "/robot/pad"
        listener = Listener(participant)
        for topic, kind, qos in (
            ("points", "sensor_msgs/msg/PointCloud2", SENSOR), ("image", "sensor_msgs/msg/Image", SENSOR),
            ("touch_points", "sensor_msgs/msg/PointCloud2", SENSOR), ("touches", "dermis_msgs/msg/Touches", RELIABLE),
            ("wrenches", "geometry_msgs/msg/WrenchStamped", RELIABLE), ("wrench", "geometry_msgs/msg/WrenchStamped", RELIABLE),
            ("guard", "dermis_msgs/msg/Guard", RELIABLE), ("events", "dermis_msgs/msg/Event", RELIABLE),
            ("patch", "dermis_msgs/msg/Patch", LATCHED),
        ):
            listener.add(f"{name}/{topic}", kind, qos)
        listener.add("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", RELIABLE)
        listener.add("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
        listener.add("ros_discovery_info", ros2_types.discovery_types(), LATCHED)
        of = lambda topic: listener.found[f"{name}/{topic}"]
        if not listener.listen(lambda: of("patch"), 60):
            run.process.kill()
            print("no message came over the loopback interface")
            sys.exit(UNREACHABLE)
        pressed = lambda: sum(1 for message in of("touches") if message.touches) > 60 and len(of("wrenches")) > 40
        require(listener.listen(pressed, 60), f"touches: {len(of('touches'))}, wrenches: {len(of('wrenches'))}")
        tare(participant, f"{name}/tare", listener, of)
        late = Listener(DomainParticipant(DOMAIN)).add(f"{name}/patch", "dermis_msgs/msg/Patch", LATCHED)
        # An earlier description may come first, in order.
        newest = lambda: any(patch.baseline == "tare" for patch in late.found[f"{name}/patch"])
        require(late.listen(newest, 20), "a late joiner gets no description")
        listener.listen(lambda: False, 0.5)
        said = run.stop()
        require("ros2: /robot/pad" in said and ", 0 dropped, 0 refused" in said, said)
        points = check_shape(late.found[f"{name}/patch"][-1], of("patch")[-1], of("points")[-1])
        images = {stamp_ns(image): image for image in of("image")}
        image = np.frombuffer(bytes(images[stamp_ns(of("points")[-1])].data), "<f4")
        require(np.array_equal(image[np.array(of("patch")[-1].pixels)], points[:, 6]), "image and cloud differ")
        check_touches(run.frames(), of)
        check_node(listener, name)


def tare(participant, service, listener, of):
    """The service, as a client with rmw_cyclonedds calls it: refused while something presses, accepted otherwise."""
    request_type, reply_type = ros2_types.trigger_types()
    requests = DataWriter(participant, Topic(participant, f"rq{service}Request", request_type), qos=RELIABLE)
    replies = DataReader(participant, Topic(participant, f"rr{service}Reply", reply_type), qos=RELIABLE)
    time.sleep(1)
    outcomes = set()
    for number in range(1, 200):
        requests.write(request_type(client=7, number=number, structure_needs_at_least_one_member=0))
        found = []
        end = time.monotonic() + 5
        while not found and time.monotonic() < end:
            listener.listen(lambda: False, 0.02)
            found = [reply for reply in replies.take(10) if reply.sample_info.valid_data]
        require(found and (found[0].client, found[0].number) == (7, number), f"reply to request {number}: {found}")
        expected = "taring over 32 frames" if found[0].success else "tare refused: "
        require(found[0].message.startswith(expected), found[0].message)
        outcomes.add(found[0].success)
        # A press that begins meanwhile cancels the tare.
        if found[0].success and listener.listen(lambda: of("patch")[-1].baseline == "tare", 60 / RATE):
            break
        listener.listen(lambda: False, 0.2)
    require(of("patch")[-1].baseline == "tare", f"no description after a tare: {outcomes}")
    require({"tare", "guard"} <= {event.event for event in of("events")}, "events of the tare and of the guard")
    print(f"tare: {number} requests, outcomes {sorted(outcomes)}")


def check_touches(lines, of):
    """Touches, wrenches and verdicts against the lines."""
    worst_n, compared = 0.0, 0
    wrenches = {}
    for wrench in of("wrenches"):
        wrenches.setdefault(stamp_ns(wrench), []).append(wrench.wrench)
    nets = {stamp_ns(net): net.wrench for net in of("wrench")}
    for message in of("touches"):
        line = lines.get(message.sequence)
        require(line is not None and message.header.frame_id == "gel-pad", f"frame {message.sequence}")
        there = [touch for touch in message.touches if touch.phase != "end"]
        printed = [touch for touch in line["touches"] if touch["phase"] != "end"]
        require([touch.id for touch in there] == [touch["id"] for touch in printed], f"touches of frame {message.sequence}")
        for touch, expected in zip(there, printed):
            require(abs(1e3 * touch.x_m - expected["x_mm"]) < 1e-3 and abs(1e3 * touch.y_m - expected["y_mm"]) < 1e-3, "places")
        found = wrenches.get(stamp_ns(message), [])
        known = [touch for touch in there if np.isfinite(touch.force_n)]
        if len(found) == len(known) == len(there):
            for touch, wrench in zip(there, found):
                force, torque = wrench.force, wrench.torque
                require((force.x, force.y) == (0, 0) and abs(force.z + touch.force_n) < 1e-9, "a force acts on the sensor")
                lever = np.cross([touch.x_m, touch.y_m, 0], [0, 0, force.z])
                require(np.allclose(lever, [torque.x, torque.y, torque.z], atol=1e-12), "torque about the origin")
                compared += 1
            net = nets[stamp_ns(message)]
            worst_n = max(worst_n, abs(net.force.z + sum(touch.force_n for touch in there)))
    require(compared > 30 and worst_n < 1e-9, f"{compared} wrenches, net force off by {worst_n} N")
    for verdict in of("guard"):
        printed = lines[verdict.sequence]["guard"]
        require((verdict.verdict, list(verdict.reasons), verdict.safety_rated) == (printed["verdict"], printed["reasons"], False), "verdict")
    print(f"touches: {len(of('touches'))} frames, {compared} wrenches, {len(of('guard'))} verdicts, {len(of('points'))} clouds")


def check_node(listener, name):
    """The node's name, its diagnosis and the mount."""
    nodes = [node for info in listener.found["ros_discovery_info"] for node in info.node_entities_info_seq]
    node = nodes[-1]
    require((node.node_namespace, node.node_name, len(node.reader_gid_seq)) == ("/robot", "pad", 1), f"the node: {node}")
    diagnoses = [status for array in listener.found["/diagnostics"] for status in array.status]
    running = [(status, {pair.key: pair.value for pair in status.values}) for status in diagnoses if status.level < 2]
    best, values = max(running, key=lambda pair: int(pair[1]["frames"]))
    # A slow machine drops frames of the twin and reports it.
    calm = (best.level, best.message) == (0, "running") or (best.level == 1 and "frames lost" in best.message)
    require(best.name == "pad: gel-pad" and best.hardware_id == values["source"] == "twin:gel-pad" and calm, f"diagnosis: {best}")
    require(float(values["frames_per_s"]) > 1 and values["messages_dropped"] == "0" and values["lost"] == "0", f"diagnosis: {values}")
    mount = listener.found["/tf_static"][-1].transforms[0]
    place, turn = mount.transform.translation, mount.transform.rotation
    require((mount.header.frame_id, mount.child_frame_id) == ("forearm", "gel-pad"), "frames of the mount")
    require(np.allclose([place.x, place.y, place.z], [0.01, 0.02, 0.03]), "place of the mount")
    require(np.allclose(np.abs([turn.x, turn.y, turn.z, turn.w]), [0, 0, 0.5**0.5, 0.5**0.5]), "rotation of the mount")
    print(f"node: {len(node.writer_gid_seq)} topics, {len(diagnoses)} diagnoses, {name}")


def check_body(program):
    """A robot: wrenches per link, transforms of moving joints, joint values from a topic."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([program, "body", "demo", "arm"], cwd=folder, check=True, capture_output=True)
        run = Dermis(program, "arm/arm.toml", "--ros2", "--joints", "sweep", folder=folder)
        listener = Listener(DomainParticipant(DOMAIN))
        listener.add("/tf", "tf2_msgs/msg/TFMessage", RELIABLE).add("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
        listener.add("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", RELIABLE)
        net = "/dermis/links/palm/wrench"
        listener.add(net, "geometry_msgs/msg/WrenchStamped", RELIABLE)
        patches = lambda: {line["patch"]: line for line in list(run.lines) if "patch" in line}
        found = listener.found
        require(listener.listen(lambda: len(found["/tf"]) > 20 and found["/tf_static"] and found["/diagnostics"], 120), "no transforms")
        require(listener.listen(lambda: len(patches()) >= 2, 60), "no patches")
        require(listener.listen(lambda: any(message.wrench.force.z for message in found[net]), 60), "no net wrench of the palm")
        names = set(patches())
        statics = {t.child_frame_id: t.header.frame_id for t in found["/tf_static"][-1].transforms}
        # A link is also called palm.
        frame = lambda patch: f"{patch}_skin" if patch in ("palm", "forearm") else patch
        require(all(statics.get(frame(patch)) == line["link"] for patch, line in patches().items()), f"mounts: {statics}")
        moving = {t.child_frame_id for message in found["/tf"] for t in message.transforms}
        require(moving and not moving & set(statics), f"{moving} move, {set(statics)} don't")
        printed = {line["clocks"]["wall_ns"]: line["link_wrench"] for line in list(run.lines) if line.get("patch") == "palm"}
        for message in found[net]:
            force, expected = message.wrench.force, printed.get(stamp_ns(message))
            if expected is not None:
                same = np.allclose([force.x, force.y, force.z], expected["force_n"], atol=1e-9)
                require(same and message.header.frame_id == "palm", f"net wrench {message}, printed {expected}")
        diagnosed = {status.name for array in found["/diagnostics"] for status in array.status}
        require(diagnosed == {f"dermis: {patch}" for patch in names}, f"diagnoses of {diagnosed}")
        run.stop()
        run = Dermis(program, "arm/arm.toml", "--ros2", "--joints", "ros2:/joint_states", folder=folder)
        participant = DomainParticipant(DOMAIN)
        kind = TYPES["sensor_msgs/msg/JointState"]
        joints = DataWriter(participant, Topic(participant, "rt/joint_states", kind), qos=RELIABLE)
        from_ros = lambda: [line for line in list(run.lines) if line.get("joints", {}).get("state") == "fresh"]
        end = time.monotonic() + 120
        header = TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](0, 0), "")
        needed = ["shoulder_yaw", "shoulder_pitch", "elbow", "nonsense"]
        problems = lambda: [line["health"]["joints_problem"] for line in list(run.lines) if "health" in line]
        while (len(from_ros()) < 20 or not any(problems())) and time.monotonic() < end:
            joints.write(kind(header, needed, [0.1, 0.2, 0.3, 0.0], [], []))
            time.sleep(0.02)
        run.stop()
        require(len(from_ros()) >= 20, f"joint values don't arrive: {problems()}")
        require("no such joint: nonsense" in problems(), f"unknown joints are not named: {problems()}")
        print(f"body: {len(names)} patches, {len(moving)} moving links, {len(from_ros())} frames with joints of a topic")


STALLED_READER = """
import sys; sys.argv = ["check_ros2.py"]
from check_ros2 import *
listener = Listener(DomainParticipant(int(os.environ["CHECK_DOMAIN"])))
listener.add("/dermis/touches", "dermis_msgs/msg/Touches", RELIABLE).add("/dermis/points", "sensor_msgs/msg/PointCloud2", SENSOR)
listener.listen(lambda: len(listener.found["/dermis/touches"]) > 10, 60)
print("reading", flush=True)
listener.listen(lambda: False, 600)
"""


def check_stalled(program):
    """A reader that is stopped in mid-stream costs neither frames nor the messages of other readers."""
    run = Dermis(program, "healing-square", "--ros2", "--ros2-clouds-per-s=25")
    listener = Listener(DomainParticipant(DOMAIN)).add("/dermis/touches", "dermis_msgs/msg/Touches", RELIABLE)
    touches = listener.found["/dermis/touches"]
    require(listener.listen(lambda: len(touches) > 10, 60), "no touches")
    environment = {**os.environ, "CHECK_DOMAIN": str(DOMAIN), "PYTHONPATH": str(ROOT / "scripts")}
    reader = subprocess.Popen([sys.executable, "-c", STALLED_READER], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        require(reader.stdout.readline().strip() == "reading", "the second reader gets nothing")
        reader.send_signal(signal.SIGSTOP)
        before, printed = len(touches), len(run.frames())
        listener.listen(lambda: False, 8)
        got, made = len(touches) - before, len(run.frames()) - printed
    finally:
        reader.kill()
    said = run.stop()
    require(made > 8 * 25 * 0.8, f"{made} frames in 8 s next to a stalled reader")
    require(got >= made - 5, f"another reader got {got} of {made} messages next to a stalled one")
    require(", 0 dropped" in said, said)
    print(f"stalled reader: {made} frames in 8 s, another reader got {got}")


def cpu_s(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


SENDER = """
import socket, sys, time
import numpy as np
frames = [row.tobytes() for row in np.load(sys.argv[1]).astype("<f4")]
server = socket.create_server(("127.0.0.1", int(sys.argv[2])))
connection, _ = server.accept()
connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
begun, number = time.monotonic(), 0
while True:
    connection.sendall(frames[number % len(frames)])
    number += 1
    time.sleep(max(0.0, begun + number * 1e-3 - time.monotonic()))
"""


def measure(program, seconds=20):
    """CPU time, drops, and latency from a frame's first byte to this process, at 1,000 frames and 100 clouds per second."""
    with tempfile.TemporaryDirectory() as folder:
        recorded, frames, port = f"{folder}/frames.mcap", f"{folder}/frames.npy", 20_000 + os.getpid() % 10_000
        for arguments in (["record", "healing-square", "--speed", "0", "--frames", "600", "--out", recorded],
                          ["export", recorded, "--format", "npy", "--out", frames]):
            subprocess.run([program, *arguments], check=True, capture_output=True)
        options = ["--source", f"tcp:127.0.0.1:{port}#floats:{np.load(frames).shape[1]}", "--only-touches"]
        for follow in (with_ros2, without_ros2):
            sender = subprocess.Popen([sys.executable, "-c", SENDER, frames, str(port)], stderr=subprocess.DEVNULL)
            time.sleep(1)
            try:
                follow(program, options, seconds)
            finally:
                sender.kill()
                sender.wait()


def with_ros2(program, options, seconds):
    run = Dermis(program, "healing-square", *options, "--ros2", "--ros2-clouds-per-s=100")
    participant = DomainParticipant(DOMAIN)
    latencies = {"touches": [], "points": []}
    readers = {
        "touches": DataReader(participant, Topic(participant, "rt/dermis/touches", TYPES["dermis_msgs/msg/Touches"]), qos=RELIABLE),
        "points": DataReader(participant, Topic(participant, "rt/dermis/points", TYPES["sensor_msgs/msg/PointCloud2"]), qos=SENSOR),
    }
    begun = None
    while begun is None or time.monotonic() < begun[0] + seconds:
        for topic, reader in readers.items():
            for sample in reader.take(100):
                now_ns = time.time_ns()
                if begun is None and topic == "points":
                    begun = (time.monotonic(), cpu_s(run.process.pid))
                if begun is not None:
                    latencies[topic].append(now_ns - stamp_ns(sample))
        time.sleep(0.0002)
    used = (cpu_s(run.process.pid) - begun[1]) / (time.monotonic() - begun[0])
    run.process.send_signal(signal.SIGINT)
    run.process.wait(30)
    for topic, found in latencies.items():
        p50, p99 = np.percentile(np.array(found) / 1e6, [50, 99])
        print(f"{topic}: {len(found) / seconds:.0f}/s, latency p50 {p50:.2f} ms, p99 {p99:.2f} ms")
    print(f"CPU with --ros2: {100 * used:.0f} % of a core")
    print("".join(run.errors).strip())


def without_ros2(program, options, seconds):
    run = Dermis(program, "healing-square", *options)
    time.sleep(5)
    before = cpu_s(run.process.pid)
    time.sleep(seconds)
    print(f"CPU without: {100 * (cpu_s(run.process.pid) - before) / seconds:.0f} % of a core")
    run.process.send_signal(signal.SIGINT)
    run.process.wait(30)
    print("".join(run.errors).strip())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dermis")
    parser.add_argument("--throughput", action="store_true")
    arguments = parser.parse_args()
    program = str(Path(arguments.dermis).resolve())
    if arguments.throughput:
        return measure(program)
    check_definitions()
    check_refusals(program)
    check_skin(program)
    check_stalled(program)
    check_body(program)


if __name__ == "__main__":
    main()
