"""Names of ROS 2 on zenoh: keys, liveliness tokens and attachments of rmw_zenoh, keys of zenoh-bridge-ros2dds."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass
from typing import NamedTuple

_ATTACHMENT = struct.Struct("<qqB16s")
NODE = "kilter"
# Reliable, volatile, the last ten: what a ROS 2 publisher or subscription has unless it says otherwise.
QOS = "::,10:,:,:,,"


@dataclass(frozen=True)
class MessageType:
    """A type of ROS 2 with the hash of its definition (REP 2016), which never changes."""

    name: str
    rihs01: str

    @property
    def dds(self) -> str:
        """Name of the type on the wire."""
        package, _, kind = self.name.partition("/")
        return f"{package}::msg::dds_::{kind}_"


JOINT_STATE = MessageType(
    "sensor_msgs/JointState", "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
)
JOINT_TRAJECTORY = MessageType(
    "trajectory_msgs/JointTrajectory", "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
)


def rmw_key(domain: int, topic: str, message: MessageType) -> str:
    """Key on which rmw_zenoh publishes a topic."""
    return f"{domain}/{topic.strip('/')}/{message.dds}/{message.rihs01}"


def rmw_keys(domain: int, topic: str, message: MessageType) -> str:
    """Key expression of a topic whatever the publisher says of the type's hash."""
    return f"{domain}/{topic.strip('/')}/{message.dds}/*"


def bridge_key(topic: str) -> str:
    """Key under which zenoh-bridge-ros2dds carries a topic."""
    return topic.strip("/")


def node_token(domain: int, zid: str) -> str:
    """Liveliness token of the node, for ``ros2 node list``."""
    return f"@ros2_lv/{domain}/{zid}/0/0/NN/%/%/{NODE}"


def topic_token(domain: int, zid: str, entity: int, kind: str, topic: str, message: MessageType) -> str:
    """Liveliness token of a publisher (kind "MP") or subscription ("MS"), for ``ros2 topic list`` and ``info``."""
    where = f"@ros2_lv/{domain}/{zid}/0/{entity}/{kind}/%/%/{NODE}"
    return f"{where}/{topic.replace('/', '%')}/{message.dds}/{message.rihs01}/{QOS}"


def publisher_gid(token: str) -> bytes:
    """16 bytes that identify a publisher; any constant ones will do."""
    return hashlib.blake2b(token.encode(), digest_size=16).digest()


class Attachment(NamedTuple):
    """What rmw_zenoh sends along: number of the message, time of sending (ns since 1970), publisher."""

    seq: int
    sent_ns: int
    gid: bytes

    def encode(self) -> bytes:
        """33 bytes; a ROS process that gets others throws the message away, or worse."""
        return _ATTACHMENT.pack(self.seq, self.sent_ns, len(self.gid), self.gid)


def decode_attachment(data: bytes | None) -> Attachment | None:
    """Read an attachment; None when it is not one."""
    if data is None or len(data) != _ATTACHMENT.size:
        return None
    seq, sent_ns, size, gid = _ATTACHMENT.unpack(data)
    return Attachment(seq, sent_ns, gid) if size == len(gid) and seq >= 0 and sent_ns >= 0 else None
