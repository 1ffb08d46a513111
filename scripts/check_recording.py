#!/usr/bin/env python3
"""Opens a recording with readers that know nothing of dermis, and compares their results.

    check_recording.py press.mcap [--tables FRAMES.npy FRAMES.csv FRAMES.parquet] [--rerun]

Needs mcap, mcap-ros2-support, rosbags and numpy from PyPI; pyarrow for a Parquet table; rerun-sdk for --rerun. Ends
with status 1 and a message at the first failure.
"""

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

STANDARD = {
    "/dermis/image": "sensor_msgs/msg/Image",
    "/dermis/points": "sensor_msgs/msg/PointCloud2",
    "/dermis/touch_points": "sensor_msgs/msg/PointCloud2",
}
OWN = {
    "/dermis/frames": "dermis_msgs/msg/Frame",
    "/dermis/baselines": "dermis_msgs/msg/Baseline",
    "/dermis/touches": "dermis_msgs/msg/Touches",
    "/dermis/events": "dermis_msgs/msg/Event",
}


def require(condition, message):
    if not condition:
        sys.exit(f"check_recording: {message}")


def cloud_points(message):
    """Points of a PointCloud2 as a structured array."""
    codes = {6: "<u4", 7: "<f4"}
    fields = [(field.name, codes[field.datatype], field.offset) for field in message.fields]
    dtype = np.dtype({
        "names": [name for name, _, _ in fields],
        "formats": [code for _, code, _ in fields],
        "offsets": [offset for _, _, offset in fields],
        "itemsize": message.point_step,
    })
    require(message.row_step == message.point_step * message.width, "row_step of a point cloud")
    require(len(message.data) == message.row_step * message.height, "length of a point cloud")
    return np.frombuffer(bytes(message.data), dtype)


def image_values(message):
    require(message.encoding == "32FC1" and message.step == 4 * message.width, "encoding of an image")
    return np.frombuffer(bytes(message.data), "<f4").reshape(message.height, message.width)


def with_mcap(path):
    """The reference reader: counts, attachments, metadata, and frames decoded with the definitions in the file."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    frames, images, clouds, touches, points, events, baselines = {}, {}, {}, {}, {}, [], []
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        require(reader.get_header().profile == "ros2", "profile of the file")
        summary = reader.get_summary()
        require(summary is not None and summary.statistics is not None, "the file has no summary")
        found = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
        require(found == {**OWN, **STANDARD}, f"topics and types: {found}")
        encodings = {(s.encoding, c.message_encoding) for s in summary.schemas.values() for c in summary.channels.values()}
        require(encodings == {("ros2msg", "cdr")}, f"encodings: {encodings}")
        attachments = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        require(attachments["skin.toml"].decode() == metadata["dermis.skin"]["toml"], "the attached skin file")
        layout = json.loads(metadata["dermis.recording"]["layout"])
        counts = Counter()
        order = []
        for decoded in reader.iter_decoded_messages(log_time_order=False):
            topic, message, log_ns = decoded.channel.topic, decoded.decoded_message, decoded.message.log_time
            counts[topic] += 1
            if topic == "/dermis/frames":
                require(message.host_wall_ns == log_ns, "log time of a frame")
                frames[message.sequence] = np.array(message.values)
                order.append(message.sequence)
            elif topic == "/dermis/image":
                images[log_ns] = image_values(message)
                require(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == log_ns, "stamp of an image")
            elif topic == "/dermis/points":
                clouds[log_ns] = cloud_points(message)
            elif topic == "/dermis/touches":
                require(message.sequence in frames, "touches come before their frame")
                touches[log_ns] = message
            elif topic == "/dermis/touch_points":
                points[log_ns] = cloud_points(message)
            elif topic == "/dermis/events":
                events.append(message)
            elif topic == "/dermis/baselines":
                baselines.append(message)
        require(dict(counts) == {summary.channels[k].topic: v for k, v in summary.statistics.channel_message_counts.items() if v},
                "counts of the statistics")
    require(int(metadata["dermis.finished"]["frames"]) == len(frames) == len(order), "frames counted at the end")
    if layout["kind"] == "channels":
        require({len(values) for values in frames.values()} == {layout["count"]}, "channels of the frames")
    require(images and images.keys() == clouds.keys(), "an image and a point cloud at the same times")
    for time_ns, image in images.items():
        inside = image[np.isfinite(image)]
        require(np.array_equal(inside, clouds[time_ns]["pressure"]), "values of image and point cloud")
    require(touches and touches.keys() == points.keys(), "touches and their points at the same times")
    for time_ns, message in touches.items():
        there = [touch for touch in message.touches if touch.phase != "end"]
        require([touch.id for touch in there] == list(points[time_ns]["id"]), "identities of touches and points")
        require(np.allclose([touch.x_m for touch in there], points[time_ns]["x"], atol=1e-7), "places of touches")
    require(baselines and len(baselines[0].values) == len(baselines[0].noise_std), "the start-up baseline")
    # The image is high at the strongest touch, so the two must agree on the position, independently of dermis.
    time_ns = max(set(images) & set(touches), key=lambda t: max((x.amplitude for x in touches[t].touches), default=0.0))
    touch = max(touches[time_ns].touches, key=lambda x: x.amplitude)
    cloud = clouds[time_ns]
    peak = cloud[np.argmax(cloud["pressure"])]
    distance_mm = 1e3 * np.hypot(peak["x"] - touch.x_m, peak["y"] - touch.y_m)
    require(distance_mm < 10.0, f"the cloud's peak is {distance_mm:.1f} mm from the touch")
    print(f"mcap: {sum(counts.values())} messages, {len(frames)} frames, {len(images)} images, "
          f"{len(touches)} frames with touches, {len(events)} events, {len(baselines)} baselines; "
          f"the cloud's peak is {distance_mm:.1f} mm from the strongest touch")
    return frames, order


def with_rosbags(path, frames):
    """An independent implementation of ROS 2's formats: identical frames, bit for bit."""
    from rosbags.highlevel import AnyReader

    counts = Counter()
    with AnyReader([path]) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        require(types == {**OWN, **STANDARD}, f"topics and types for rosbags: {types}")
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            counts[connection.topic] += 1
            if connection.topic == "/dermis/frames":
                same = message.values.tobytes() == frames[message.sequence].tobytes()
                require(same, f"rosbags reads frame {message.sequence} differently")
    require(counts["/dermis/frames"] == len(frames), "frames that rosbags finds")
    print(f"rosbags: {sum(counts.values())} messages of {len(counts)} topics, {counts['/dermis/frames']} frames bit for bit")


def with_rerun(path):
    """The viewer's importer, and its result for each topic."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "recording.rrd"
        rerun = Path(sys.executable).with_name("rerun")
        done = subprocess.run([rerun, "mcap", "convert", path, "-o", target], capture_output=True, text=True)
        require(done.returncode == 0 and target.exists(), f"rerun mcap convert: {done.stdout}{done.stderr}")
        said = [line for line in (done.stdout + done.stderr).splitlines() if "WARN" in line or "ERROR" in line]
        printed = subprocess.run([rerun, "rrd", "print", "-v", target], capture_output=True, text=True).stdout
        size = target.stat().st_size
    for component in (
        "/dermis/image@DepthImage:buffer",
        "/dermis/points@Points3D:positions",
        "/dermis/points@Points3D:pressure",
        "/dermis/touch_points@Points3D:positions",
        "/dermis/frames@dermis_msgs.msg.Frame:message",
        "/dermis/touches@dermis_msgs.msg.Touches:message",
    ):
        require(component in printed, f"rerun made no {component} of the recording")
    print(f"rerun: {size} bytes; a depth image, two point clouds, frames and touches by field; {len(said)} warnings")
    for line in said:
        print(f"  {line}")


def with_tables(frames, order, tables):
    expected = np.array([frames[number] for number in order])
    for table in tables:
        if table.suffix == ".npy":
            found = np.load(table)
        elif table.suffix == ".csv":
            with table.open(newline="") as file:
                rows = list(csv.reader(file))
            found = np.array([[float(cell) for cell in row[4:]] for row in rows[1:]])
            require([int(row[0]) for row in rows[1:]] == order, f"numbers in {table.name}")
        else:
            from pyarrow import parquet

            data = parquet.read_table(table)
            require(data.column("sequence").to_pylist() == order, f"numbers in {table.name}")
            found = np.array([data.column(index).to_numpy() for index in range(4, data.num_columns)]).T
        require(found.shape == expected.shape and found.tobytes() == expected.tobytes(), f"readings in {table.name}")
        print(f"{table.name}: {found.shape[0]} x {found.shape[1]} readings bit for bit")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--tables", type=Path, nargs="*", default=[])
    parser.add_argument("--rerun", action="store_true")
    arguments = parser.parse_args()
    frames, order = with_mcap(arguments.recording)
    with_rosbags(arguments.recording, frames)
    with_tables(frames, order, arguments.tables)
    if arguments.rerun:
        with_rerun(arguments.recording)


if __name__ == "__main__":
    main()
