"""ROS 2 types for Eclipse Cyclone DDS, made from the definitions of ROS in rosbags and those of dermis in
crates/dermis-record/dermis_msgs. A message that doesn't match its definition can't be read."""

import dataclasses
import types as python_types
from pathlib import Path

import cyclonedds.idl.types as idl
from cyclonedds.idl import IdlStruct
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

MESSAGES = Path(__file__).resolve().parent.parent / "crates/dermis-record/dermis_msgs/msg"
BASE = {
    "bool": bool, "string": str, "byte": idl.uint8, "octet": idl.uint8, "char": idl.uint8, "uint8": idl.uint8,
    "int8": idl.int8, "int16": idl.int16, "uint16": idl.uint16, "int32": idl.int32, "uint32": idl.uint32,
    "int64": idl.int64, "uint64": idl.uint64, "float32": idl.float32, "float64": idl.float64,
}


def own_types():
    """The definitions of dermis, as rosbags reads them."""
    found = {}
    for file in sorted(MESSAGES.glob("*.msg")):
        found.update(get_types_from_msg(file.read_text(), f"dermis_msgs/msg/{file.stem}"))
    return found


def listed_types():
    """The messages that the ROS package lists."""
    text = (MESSAGES.parent / "CMakeLists.txt").read_text()
    return {line.strip().strip('"')[4:-4] for line in text.splitlines() if line.strip().startswith('"msg/')}


class Types:
    """Types by their names in ROS: `types["sensor_msgs/msg/Image"]`."""

    def __init__(self):
        store = get_typestore(Stores.ROS2_HUMBLE)
        store.register(own_types())
        self.definitions = store.fielddefs
        self.made = {}

    def __getitem__(self, name):
        if name not in self.made:
            fields = {field: self.annotation(kind) for field, kind in self.definitions[name][1]}
            self.made[name] = struct(name, fields)
        return self.made[name]

    def annotation(self, kind):
        node, of = kind
        if node == Nodetype.BASE:
            return BASE[of[0]]
        if node == Nodetype.NAME:
            return self[of]
        inner, length = of
        inner = self.annotation(inner)
        return idl.array[inner, length] if node == Nodetype.ARRAY else idl.sequence[inner]


def struct(name, fields):
    """A structure with the name that ROS 2 gives it in DDS."""
    package, _, kind = name.rpartition("/")
    typename = f"{package.replace('/', '::')}::dds_::{kind}_"
    made = python_types.new_class(kind, (IdlStruct,), {"typename": typename}, lambda names: names.update(__annotations__=fields))
    return dataclasses.dataclass(made)


def discovery_types():
    """`rmw_dds_common/ParticipantEntitiesInfo`, as from Iron on."""
    gid = struct("rmw_dds_common/msg/Gid", {"data": idl.array[idl.uint8, 16]})
    node = struct("rmw_dds_common/msg/NodeEntitiesInfo", {
        "node_namespace": str, "node_name": str, "reader_gid_seq": idl.sequence[gid], "writer_gid_seq": idl.sequence[gid],
    })
    return struct("rmw_dds_common/msg/ParticipantEntitiesInfo", {"gid": gid, "node_entities_info_seq": idl.sequence[node]})


def trigger_types():
    """Request and reply of `std_srvs/Trigger` as rmw_cyclonedds sends them, with its own header."""
    header = {"client": idl.uint64, "number": idl.int64}
    request = struct("std_srvs/srv/Trigger_Request", {**header, "structure_needs_at_least_one_member": idl.uint8})
    reply = struct("std_srvs/srv/Trigger_Response", {**header, "success": bool, "message": str})
    return request, reply
