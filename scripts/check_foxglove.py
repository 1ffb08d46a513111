#!/usr/bin/env python3
"""Connects to `dermis run --foxglove` as a viewer that knows nothing of dermis, and checks what it receives.

    check_foxglove.py DERMIS [--keep capture.mcap]

DERMIS is the command, built with the feature `foxglove`. Needs websockets, rosbags, foxglove-schemas-protobuf,
mcap, mcap-ros2-support, mcap-protobuf-support and numpy from PyPI. The client follows the published protocol
`foxglove.sdk.v1`; messages are decoded by rosbags and by the published protobuf schemas. Ends with status 1 and a
message at the first failure.
"""

import argparse
import base64
import json
import os
import re
import socket
import subprocess
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from foxglove_viewer import PATIENCE_S, Viewer, cloud, require, turned, xyz

ROOT = Path(__file__).resolve().parent.parent
GUARD_N = 3.0
LINK = "forearm"
XYZ_MM = (100.0, 0.0, 30.0)


class Process:
    """A running command that prints its address."""

    def __init__(self, arguments, folder, word):
        self.lines = []
        self.process = subprocess.Popen(
            arguments, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        said = threading.Event()

        def read():
            for line in self.process.stdout:
                self.lines.append(line)
                if line.startswith(word):
                    self.said = line[len(word) :].strip()
                    said.set()

        threading.Thread(target=read, daemon=True).start()
        require(said.wait(PATIENCE_S), f"{arguments} did not say {word}: {self.lines[-5:]}")

    def tell(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def frames(self):
        return sum(line.startswith('{"') and '"sequence"' in line for line in self.lines)

    def cpu_s(self):
        """CPU time of all threads so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self):
        if self.process.poll() is None:
            self.process.send_signal(2)
        try:
            return self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            require(False, "the command does not end when it is interrupted")


def gel(folder):
    """A gel whose force law is known, on a link, with a limit and without a demonstration."""
    text = (ROOT / "skins/examples/gel-pad.toml").read_text()
    mount = f'[mount]\nlink = "{LINK}"\nxyz_mm = {list(XYZ_MM)}\nrpy_deg = [0, 0, 90]\n'
    guard = f"[guard]\nforce_n = {GUARD_N}\n"
    (folder / "gel.toml").write_text(f'{text}\n{mount}\n{guard}\n[twin]\ndemonstration = "none"\n')


def check_what_is_advertised(viewer, recording):
    """Names and definitions are the same as in a recording."""
    from mcap.reader import make_reader

    served = {c["topic"]: (c["schemaName"], c["schemaEncoding"], c["encoding"]) for c in viewer.channels.values()}
    with recording.open("rb") as file:
        summary = make_reader(file).get_summary()
        recorded = {c.topic: (summary.schemas[c.schema_id], c.message_encoding) for c in summary.channels.values()}
    for topic, (schema, encoding) in recorded.items():
        require(served.get(topic) == (schema.name, schema.encoding, encoding), f"{topic}: {served.get(topic)}")
        own = next(c for c in viewer.channels.values() if c["topic"] == topic)
        require(own["schema"] == schema.data.decode(), f"{topic}: the definitions differ")
    extra = {topic: names[0] for topic, names in served.items() if topic not in recorded}
    expected = {
        "/dermis/scene": "foxglove.SceneUpdate",
        "/dermis/transforms": "foxglove.FrameTransforms",
        "/dermis/log": "foxglove.Log",
    }
    require(extra == expected, f"topics that are not recorded: {extra}")
    layout = json.loads((ROOT / "crates/dermis-record/foxglove/layout.json").read_text())
    named = set(re.findall(r'"(/dermis/[a-z_]+)', json.dumps(layout)))
    missing = named - set(served) - set(viewer.services)
    require(named and not missing, f"the layout names what is not served: {missing}")


def check_parameters(viewer):
    """Limits are read-only, lambda can be set."""
    values = viewer.parameters(op="getParameters", parameterNames=[])
    require(values["guard.force_n"] == GUARD_N and values["guard.any_touch"] is False, f"limits: {values}")
    require(values["name"] == "gel-pad" and values["frames"] > 0 and values["frames_lost"] == 0, f"counts: {values}")
    before = values["hyperparameter"]
    viewer.statuses.clear()
    wanted = [{"name": "guard.force_n", "value": 100.0, "type": "float64"}]
    after = viewer.parameters(op="setParameters", parameters=wanted)
    require(after == {"guard.force_n": GUARD_N}, f"a limit after an attempt to set it: {after}")
    require(any("guard.force_n: read-only" in s["message"] for s in viewer.statuses), f"statuses: {viewer.statuses}")
    wanted = [{"name": "hyperparameter", "value": 2 * before, "type": "float64"}]
    after = viewer.parameters(op="setParameters", parameters=wanted)
    require(after == {"hyperparameter": 2 * before}, f"lambda after setting it: {after}")
    viewer.parameters(op="setParameters", parameters=[{"name": "hyperparameter", "value": before, "type": "float64"}])
    viewer.statuses.clear()
    refused = viewer.parameters(op="setParameters", parameters=[{"name": "hyperparameter", "value": -1.0}])
    require(refused == {"hyperparameter": before} and viewer.statuses, f"a negative lambda: {refused}")


def check_a_press(viewer, twin, place_mm, force_n):
    """A press is an entity at its place, with an arrow of its force, until it ends."""
    seen = {"scene": None, "touches": None, "points": None, "gone": False}

    def take(topic, message, log_ns):
        if topic == "/dermis/scene":
            if message.entities:
                seen["scene"] = message
            seen["gone"] = any(deletion.id == seen.get("id") for deletion in message.deletions)
        elif topic == "/dermis/touches" and any(t.phase != "end" for t in message.touches):
            seen["touches"] = message
        elif topic == "/dermis/points":
            seen["points"] = cloud(message)

    def arrow_mm():
        entities = seen["scene"].entities if seen["scene"] else []
        return [1e3 * (a.shaft_length + a.head_length) for e in entities for a in e.arrows]

    viewer.until("an arrow", lambda: arrow_mm() and arrow_mm()[0] > 7 * force_n, take)
    viewer.for_s(1.5, take)
    [entity] = seen["scene"].entities
    [touch] = [touch for touch in seen["touches"].touches if touch.phase != "end"]
    seen["id"] = entity.id
    require(entity.id == f"touch-{touch.id}" and entity.frame_id == "gel-pad" and entity.frame_locked, str(entity))
    [disc], [ellipse], [arrow], [label] = entity.cylinders, entity.spheres, entity.arrows, entity.texts
    off_mm = np.hypot(*(1e3 * xyz(disc.pose.position)[:2] - place_mm))
    require(off_mm < 2, f"the touch is {off_mm:.1f} mm off")
    require(np.allclose([touch.x_m, touch.y_m], xyz(disc.pose.position)[:2], atol=2e-3), "scene and touches differ")
    direction, length_m = turned(arrow.pose.orientation, [1, 0, 0]), arrow.shaft_length + arrow.head_length
    require(np.allclose(direction, [0, 0, -1], atol=1e-9), f"the arrow points along {direction}")
    tip = xyz(arrow.pose.position) + length_m * direction
    require(np.allclose(tip, xyz(disc.pose.position), atol=1e-9), f"the arrow ends at {tip}")
    found_n = 1e2 * length_m
    require(abs(found_n - force_n) < 0.25 * force_n, f"the arrow shows {found_n:.2f} N, pressed with {force_n} N")
    require(abs(found_n - touch.force_n) < 0.1 * force_n, f"{found_n:.2f} N, touches say {touch.force_n:.2f} N")
    require(label.text == f"{touch.id}: {found_n:.2f} N", f"label {label.text}")
    require(0 < ellipse.size.x < 0.05 and 0 < ellipse.size.y <= ellipse.size.x, f"ellipse {ellipse.size}")
    points = seen["points"]
    # Pressing thins the gel, so its image is negative there.
    strongest = np.nanargmax(np.abs(points["pressure"]))
    off_image_mm = np.hypot(1e3 * points["x"][strongest] - place_mm[0], 1e3 * points["y"][strongest] - place_mm[1])
    require(off_image_mm < 10, f"the image's peak is {off_image_mm:.1f} mm off")
    reply = viewer.call("/dermis/tare", "{}")
    require(reply["success"] is False and reply["message"].startswith("tare refused: "), f"tare: {reply}")
    print(f"refused while it is pressed: {reply['message']}")
    twin.tell("release")
    viewer.until("end of the touch", lambda: seen["gone"], take)
    print(f"press of {force_n} N at {place_mm} mm: {off_mm:.2f} mm off, {found_n:.2f} N")


def check_a_tare(viewer):
    """A tare is answered and followed by a baseline and lines in the log."""
    seen = {"baseline": None, "log": []}

    def take(topic, message, log_ns):
        if topic == "/dermis/baselines":
            seen["baseline"] = message
        elif topic == "/dermis/log":
            seen["log"].append(message.message)

    deadline = time.monotonic() + PATIENCE_S
    while not (reply := viewer.call("/dermis/tare", '{"force": false}'))["success"]:
        require(time.monotonic() < deadline, f"tare: {reply}")
        viewer.for_s(0.5, take)
    require(re.fullmatch(r"taring over \d+ frames", reply["message"]), f"tare: {reply}")
    viewer.until("baseline", lambda: seen["baseline"] is not None and seen["baseline"].origin == "tare", take)
    require(seen["baseline"].reason == "requested in Foxglove", f"reason {seen['baseline'].reason}")
    viewer.until("line in the log", lambda: any("baseline (tare)" in line for line in seen["log"]), take)
    failure = viewer.call("/dermis/tare", '{"forced": true}')
    require("forced" in failure.get("message", ""), f"a mistake in a request: {failure}")


def check_single_skin(dermis, folder, keep):
    gel(folder)
    place_mm, force_n = (10.0, 5.0), 2.5
    twin = Process([dermis, "twin", "serve", "gel.toml", "--tcp", "127.0.0.1:0"], folder, "serving:")
    source = next(word for word in twin.said.split() if word.startswith("tcp:"))
    run = [dermis, "run", "gel.toml", "--source", source, "--headless", "--foxglove", "127.0.0.1:0"]
    live = Process([*run, "--record", "x.mcap"], folder, "foxglove:")
    try:
        while live.frames() < 60:
            time.sleep(0.1)
        # Connects long after the baseline was taken.
        viewer = Viewer(live.said)
        require(re.fullmatch(r"dermis \d+\.\d+\.\d+: gel-pad", viewer.info["name"]), f"name {viewer.info['name']}")
        viewer.subscribe()
        first = {}

        def take(topic, message, log_ns):
            first.setdefault(topic, (message, log_ns))

        early = {"/dermis/frames", "/dermis/baselines", "/dermis/image", "/dermis/points", "/dermis/transforms"}
        viewer.until("first messages", lambda: early <= set(first), take)
        frame, log_ns = first["/dermis/frames"]
        require(frame.host_wall_ns == log_ns and abs(log_ns - time.time_ns()) < 5e9, "log time of a frame")
        require(len(first["/dermis/baselines"][0].values) == len(frame.values), "channels of the baseline")
        image = first["/dermis/image"][0]
        require((image.encoding, len(image.data)) == ("32FC1", 4 * image.width * image.height), "image")
        points = cloud(first["/dermis/points"][0])
        require(abs(np.ptp(points["x"]) - 0.150) < 0.006 and abs(np.ptp(points["y"]) - 0.060) < 0.006, "the cloud's size")
        [mount] = first["/dermis/transforms"][0].transforms
        require((mount.parent_frame_id, mount.child_frame_id) == (LINK, "gel-pad"), str(mount))
        require(np.allclose(1e3 * xyz(mount.translation), XYZ_MM), str(mount))
        require(np.allclose(turned(mount.rotation, [1, 0, 0]), [0, 1, 0]), str(mount))

        check_parameters(viewer)
        twin.tell(f"press {place_mm[0]} {place_mm[1]} {force_n} 8")
        check_a_press(viewer, twin, np.array(place_mm), force_n)
        check_a_tare(viewer)
        check_a_stalled_viewer(live, viewer)
        code = live.stop()
        require(code == 0, f"exit code {code}: {live.lines[-5:]}")
        check_what_is_advertised(viewer, folder / "x.mcap")
        check_capture(viewer, keep or folder / "capture.mcap")
    finally:
        live.stop()
        twin.stop()


def check_a_stalled_viewer(live, viewer):
    """A viewer that stops reading slows neither the frames nor the other viewer."""

    def rate(seconds):
        counts = {"frames": 0, "all": 0}

        def take(topic, message, log_ns):
            counts["all"] += 1
            counts["frames"] += topic == "/dermis/frames"

        frames, cpu_s, begun = live.frames(), live.cpu_s(), time.monotonic()
        viewer.for_s(seconds, take)
        took_s = time.monotonic() - begun
        done = (live.frames() - frames) / took_s
        return done, counts["frames"] / took_s, counts["all"] / took_s, (live.cpu_s() - cpu_s) / took_s

    alone = rate(4)
    stalled = []
    for _ in range(3):
        other = Viewer(live.said)
        other.socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        other.subscribe()
        stalled.append(other)
    # The library keeps reading until its buffer is full.
    time.sleep(1)
    crowded = rate(10)
    for name, (done, shown, messages, cpu) in (("alone", alone), ("with three stalled viewers", crowded)):
        print(f"{name}: {done:.1f} frames/s done, {shown:.1f} shown, {messages:.0f} messages/s, {100 * cpu:.0f} % CPU")
    require(crowded[0] > 0.9 * alone[0], "the frames are slower with a stalled viewer")
    require(crowded[1] > 0.9 * alone[1], "the other viewer gets fewer frames")
    values = viewer.parameters(op="getParameters", parameterNames=["frames_not_shown", "frames_lost"])
    require(values == {"frames_not_shown": 0, "frames_lost": 0}, f"counts: {values}")
    for other in stalled:
        other.socket.socket.close()


def check_capture(viewer, path):
    """The messages, written to a file with the same channels, are readable by other readers."""
    from mcap.reader import make_reader
    from mcap.writer import Writer
    from mcap_protobuf.decoder import DecoderFactory as Protobuf
    from mcap_ros2.decoder import DecoderFactory as Ros2

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {}
        for channel in viewer.channels.values():
            text = channel["schema"]
            schema = base64.b64decode(text) if channel["schemaEncoding"] == "protobuf" else text.encode()
            id = writer.register_schema(channel["schemaName"], channel["schemaEncoding"], schema)
            channels[channel["topic"]] = writer.register_channel(channel["topic"], channel["encoding"], id)
        for topic, log_ns, data in viewer.kept:
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()
    counts = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[Ros2(), Protobuf()])
        for decoded in reader.iter_decoded_messages():
            counts[decoded.channel.topic] = counts.get(decoded.channel.topic, 0) + 1
    require(set(counts) == set(channels), f"topics without a message: {set(channels) - set(counts)}")
    print("capture:", ", ".join(f"{topic} {count}" for topic, count in sorted(counts.items())))


def check_body(dermis, folder):
    """Every patch of a body has its topics below its name, and the links move."""
    subprocess.run([dermis, "body", "demo", "arm"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    run = [dermis, "run", "arm/arm.toml", "--headless", "--joints", "sweep", "--foxglove", "127.0.0.1:0"]
    live = Process(run, folder, "foxglove:")
    try:
        viewer = Viewer(live.said)
        topics = {channel["topic"] for channel in viewer.channels.values()}
        patches = sorted(m[1] for m in (re.fullmatch("/dermis/([^/]+)/frames", topic) for topic in topics) if m)
        require(len(patches) == 4, f"patches {patches}")
        for patch in patches:
            names = ("frames", "baselines", "touches", "events", "image", "points", "touch_points", "scene")
            require({f"/dermis/{patch}/{name}" for name in names} <= topics, f"{patch}: {sorted(topics)}")
            require(f"/dermis/{patch}/tare" in viewer.services, f"{patch}: {sorted(viewer.services)}")
        viewer.subscribe("/dermis/transforms", "/joint_states", *(f"/dermis/{patch}/scene" for patch in patches))
        poses, touched, joints = {}, {}, []

        def take(topic, message, log_ns):
            if topic == "/dermis/transforms":
                for transform in message.transforms:
                    poses.setdefault(transform.child_frame_id, []).append(transform)
            elif topic == "/joint_states":
                joints.append(dict(zip(message.name, message.position)))
            else:
                for entity in message.entities:
                    touched[topic.split("/")[2]] = entity.frame_id

        viewer.until("touch of every patch", lambda: len(touched) == len(patches) and len(joints) > 20, take)
        require(all(touched[patch] in poses for patch in patches), f"frames {touched}, poses {sorted(poses)}")
        moving = [child for child, seen in poses.items() if len({round(t.rotation.w, 6) for t in seen}) > 5]
        require(moving and len({tuple(j.values()) for j in joints}) > 20, f"moving links: {moving}")
        # Every frame leads to the root.
        parent = {child: seen[0].parent_frame_id for child, seen in poses.items()}
        roots = set(parent.values()) - set(parent)
        require(len(roots) == 1, f"roots {roots}")
        for patch in patches:
            frame = touched[patch]
            while frame in parent:
                frame = parent[frame]
            require(frame in roots, f"{patch} leads to {frame}")
        reply = viewer.call(f"/dermis/{patches[0]}/tare", '{"force": true}')
        require(reply["success"], f"tare of {patches[0]}: {reply}")
        values = viewer.parameters(op="getParameters", parameterNames=[])
        require(all(values[f"{patch}.frames"] > 0 for patch in patches), f"counts: {values}")
        print(f"body: patches {', '.join(patches)}; {len(poses)} frames, {len(moving)} of them moving")
    finally:
        live.stop()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dermis", type=Path)
    parser.add_argument("--keep", type=Path, help="where to write the capture")
    arguments = parser.parse_args()
    dermis = str(arguments.dermis.resolve())
    with tempfile.TemporaryDirectory() as name:
        check_single_skin(dermis, Path(name), arguments.keep)
        check_body(dermis, Path(name))
    print("check_foxglove: what viewers are shown is right")


if __name__ == "__main__":
    main()
