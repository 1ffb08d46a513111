"""A client of Foxglove's protocol that knows nothing of dermis, for `check_foxglove.py`."""

import json
import re
import struct
import sys
import time

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from websockets.sync.client import connect

PATIENCE_S = 60
SUBPROTOCOL = "foxglove.sdk.v1"
PROTOBUF = {"foxglove.SceneUpdate": SceneUpdate, "foxglove.FrameTransforms": FrameTransforms, "foxglove.Log": Log}


def require(condition, message):
    if not condition:
        sys.exit(f"check_foxglove: {message}")


class Viewer:
    """A client of the protocol."""

    def __init__(self, url):
        self.socket = connect(url, subprotocols=[SUBPROTOCOL], max_size=None, proxy=None, ping_interval=None).__enter__()
        require(self.socket.subprotocol == SUBPROTOCOL, f"subprotocol {self.socket.subprotocol}")
        self.info, self.channels, self.services, self.statuses, self.values = {}, {}, {}, [], {}
        self.subscribed, self.store, self.replies, self.calls = {}, get_typestore(Stores.EMPTY), {}, 0
        self.kept = []
        self.until("the channels", lambda: self.info and self.channels and self.services)

    def send(self, **message):
        self.socket.send(json.dumps(message))

    def subscribe(self, *topics):
        """Subscribes to these topics, or to all."""
        wanted = [c for c in self.channels.values() if not topics or c["topic"] in topics]
        require(len(wanted) == (len(topics) or len(wanted)), f"no such topic: {topics}")
        ids = {100 + channel["id"]: channel for channel in wanted}
        self.subscribed.update(ids)
        self.send(op="subscribe", subscriptions=[{"id": id, "channelId": c["id"]} for id, c in ids.items()])

    def call(self, service, payload):
        """Calls a service and returns its reply."""
        self.calls += 1
        number, encoding = self.calls, b"json"
        head = struct.pack("<BIII", 2, self.services[service]["id"], number, len(encoding))
        self.socket.send(head + encoding + payload.encode())
        self.until(f"a reply of {service}", lambda: number in self.replies)
        return self.replies.pop(number)

    def parameters(self, **message):
        """Sends a request for parameters and returns the values in the reply."""
        self.values.pop("reply", None)
        self.send(id="reply", **message)
        self.until("parameter values", lambda: "reply" in self.values)
        return {value["name"]: value["value"] for value in self.values.pop("reply")}

    def until(self, what, done, take=lambda topic, message, log_ns: None, wait_s=PATIENCE_S):
        """Reads until `done`; every message goes to `take`."""
        end = time.monotonic() + wait_s
        while not done():
            require(time.monotonic() < end, f"no {what} in {wait_s} s")
            try:
                data = self.socket.recv(timeout=1)
            except TimeoutError:
                continue
            if isinstance(data, str):
                self.text(json.loads(data))
            elif data[0] == 1:
                subscription, log_ns = struct.unpack_from("<IQ", data, 1)
                channel = self.subscribed[subscription]
                self.kept.append((channel["topic"], log_ns, data[13:]))
                take(channel["topic"], self.decode(channel, data[13:]), log_ns)
            elif data[0] == 3:
                _, number, length = struct.unpack_from("<III", data, 1)
                require(data[13 : 13 + length] == b"json", "encoding of a reply")
                self.replies[number] = json.loads(data[13 + length :])

    def for_s(self, wait_s, take):
        end = time.monotonic() + wait_s
        self.until("end", lambda: time.monotonic() >= end, take, wait_s + PATIENCE_S)

    def text(self, message):
        kind = message["op"]
        if kind == "serverInfo":
            self.info = message
        elif kind == "advertise":
            for channel in message["channels"]:
                self.channels[channel["id"]] = channel
                if channel["schemaEncoding"] == "ros2msg":
                    self.store.register(get_types_from_msg(*definitions(channel)[0]))
                    for text, name in definitions(channel)[1:]:
                        self.store.register(get_types_from_msg(text, name))
        elif kind == "advertiseServices":
            self.services.update({service["name"]: service for service in message["services"]})
        elif kind == "status":
            self.statuses.append(message)
        elif kind == "parameterValues":
            self.values[message.get("id", "update")] = message["parameters"]
        elif kind == "serviceCallFailure":
            self.replies[message["callId"]] = message

    def decode(self, channel, payload):
        if channel["encoding"] == "cdr":
            return self.store.deserialize_cdr(payload, channel["schemaName"])
        message = PROTOBUF[channel["schemaName"]]()
        message.ParseFromString(payload)
        return message

    def close(self):
        self.socket.close()


def definitions(channel):
    """The definition of a channel's type and of those that it uses, as (text, name)."""
    first, *rest = re.split(r"^=+\n", channel["schema"], flags=re.MULTILINE)
    named = [part.split("\n", 1) for part in rest]
    others = [(text, head.removeprefix("MSG: ").strip().replace("/", "/msg/", 1)) for head, text in named]
    return [(first, channel["schemaName"]), *others]


def turned(orientation, vector):
    """The vector turned by a quaternion."""
    axis, w = np.array([orientation.x, orientation.y, orientation.z]), orientation.w
    inner = np.cross(axis, vector) + w * np.array(vector)
    return np.array(vector) + 2 * np.cross(axis, inner)


def xyz(point):
    return np.array([point.x, point.y, point.z])


def cloud(message):
    """Points of a PointCloud2 with fields of four bytes."""
    names = [field.name for field in message.fields]
    return dict(zip(names, np.frombuffer(bytes(message.data), "<f4").reshape(-1, len(names)).T))
