"""ROS 2 without a ROS installation: DDS by Eclipse Cyclone DDS.

Topics, type names and settings are those of ROS 2 (its middleware names topic ``/a`` ``rt/a``, type ``pkg/msg/Name``
``pkg::msg::dds_::Name_``), so nodes with Fast DDS or Cyclone DDS receive the messages as if from a node. Nothing is
encoded here: the messages already are in CDR.
"""

from __future__ import annotations

import ctypes
import ipaddress
import os
import re
import socket
import sys
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from rosbags.interfaces import Nodetype

from ..errors import MissingExtraError, PublishError
from ..sources.mcap.messages import TYPES
from .messages import SAID_ONCE, ros_topic, type_hash
from .publisher import LiveMessage, SinkStatus

try:
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.idl import IdlStruct, make_idl_struct
    from cyclonedds.idl import types as idl
    from cyclonedds.internal import DDS
    from cyclonedds.pub import DataWriter
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.topic import Sample, Topic
except ImportError as missing:
    raise MissingExtraError("ROS 2 needs cyclonedds: install it with pip install 'tactune[live]'") from missing

#: Largest domain id whose ports exist.
MAX_DOMAIN: Final = 232
#: Messages of a topic that are kept for repeats: about 0.1 s, so that a lost part of a large one still arrives in time.
_HISTORY: Final = 4
_NAMESPACE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")

#: Announcing every second finds subscribers quickly. Lost parts are repeated all at once and after milliseconds; with
#: Cyclone's defaults, made for small messages, a point cloud would be replaced by the next before it is complete.
#: Closing does not wait for a subscriber that hangs.
_CONFIG: Final = """\
<CycloneDDS><Domain>
  <General>{general}</General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>
    <SPDPInterval>1 s</SPDPInterval>{discovery}
  </Discovery>
  <Internal>
    <HeartbeatInterval min="1 ms" minsched="2 ms" max="1 s">5 ms</HeartbeatInterval>
    <MaxQueuedRexmitBytes>32 MB</MaxQueuedRexmitBytes>
    <BurstSize><MaxRexmit>32 MB</MaxRexmit><MaxFragsRexmitSample>1024</MaxFragsRexmitSample></BurstSize>
    <WriterLingerDuration>0 s</WriterLingerDuration>
  </Internal>
  <Tracing><Verbosity>none</Verbosity></Tracing>
</Domain></CycloneDDS>"""
#: Few large datagrams, which no network card limits. Subscribers are also addressed one by one, since some listen to
#: multicast of network cards only.
_LOOPBACK: Final = {
    "general": """\
<Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces><AllowMulticast>spdp</AllowMulticast>
    <MaxMessageSize>65500 B</MaxMessageSize><MaxRexmitMessageSize>65500 B</MaxRexmitMessageSize>
    <FragmentSize>63000 B</FragmentSize>""",
    "discovery": '<Peers><Peer address="127.0.0.1"/></Peers>',
}


class DdsSink:
    """ROS 2 topics by DDS; a `tactune.core.output.publisher.Sink`.

    ``namespace`` is put before every topic but ``/tf`` and ``/tf_static``. ``host`` is the address of the network
    interface: with ``127.0.0.1`` nothing leaves this computer and nothing from outside is received; with ``0.0.0.0``
    Cyclone DDS chooses the interface, and ``CYCLONEDDS_URI`` applies. Raises `PublishError` if one is not valid.
    """

    def __init__(self, domain: int = 0, namespace: str = "", host: str = "127.0.0.1") -> None:
        if not 0 <= domain <= MAX_DOMAIN:
            raise PublishError(f"the ROS 2 domain id {domain} is not from 0 to {MAX_DOMAIN}; choose another")
        namespace = namespace.strip("/")
        if namespace and not _NAMESPACE.fullmatch(namespace):
            raise PublishError(
                f"{namespace!r} is no namespace of ROS 2; use letters, digits, _ and /, no part beginning with a digit"
            )
        try:
            self._address = ipaddress.IPv4Address(host)
        except ValueError:
            raise PublishError(f"{host!r} is no IPv4 address; give that of a network interface, or 0.0.0.0") from None
        self._domain, self._namespace = domain, namespace
        self._writers: dict[str, DataWriter[IdlStruct]] = {}
        self._entities: list[Any] = []  # in the order in which they need each other
        self._clients = 0

    def start(self, topics: Mapping[str, str]) -> None:
        try:
            self._entities.append(Domain(self._domain, self._config()))
        except DDSException as error:
            raise PublishError(
                f"ROS 2 cannot start: this computer has no network interface with the address {self._address}, "
                f"or another connection of this program uses domain {self._domain}; choose another"
            ) from error
        try:
            self._entities.append(DomainParticipant(self._domain))
            if self._address.is_loopback:
                _receive_loopback_only(self._domain)
            for topic, type_name in topics.items():
                self._writers[topic] = self._writer(topic, type_name)
        except (DDSException, PublishError) as error:
            self.close()
            raise PublishError(f"ROS 2 cannot start on {self.status().place}: {error}") from error

    def wanted(self) -> Collection[str]:
        counts = {topic: len(writer.get_matched_subscriptions()) for topic, writer in self._writers.items()}
        self._clients = max(counts.values(), default=0)
        return [topic for topic, count in counts.items() if count]

    def send(self, messages: Sequence[LiveMessage]) -> None:
        for message in messages:
            _write(self._writers[message.topic], message.data)

    def close(self) -> None:
        self._writers.clear()
        while self._entities:
            del self._entities[-1]  # nothing else holds it: Cyclone's own is deleted with it
        self._clients = 0

    def status(self) -> SinkStatus:
        """Return the state; ``clients`` is the number of subscribers of the topic that has most."""
        place = f"domain {self._domain}, {self._address}"
        return SinkStatus("ROS 2", f"{place}, /{self._namespace}" if self._namespace else place, self._clients)

    def _config(self) -> str:
        if self._address.is_loopback:
            return _CONFIG.format(**_LOOPBACK)
        choice = 'autodetermine="true"' if self._address.is_unspecified else f'address="{self._address}"'
        general = f"<Interfaces><NetworkInterface {choice}/></Interfaces>"
        return ",".join((_CONFIG.format(general=general, discovery=""), os.environ.get("CYCLONEDDS_URI", "")))

    def _writer(self, topic: str, type_name: str) -> DataWriter[IdlStruct]:
        name = f"rt{ros_topic(topic, self._namespace)}"
        self._entities.append(Topic(self._entities[1], name, _dds_type(type_name)))
        is_kept = topic in SAID_ONCE
        qos = Qos(
            Policy.Reliability.Reliable(max_blocking_time=0),
            Policy.Durability.TransientLocal if is_kept else Policy.Durability.Volatile,
            Policy.History.KeepLast(1 if is_kept else _HISTORY),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(f"typehash={type_hash(type_name)};".encode()),
        )
        self._entities.append(DataWriter(self._entities[1], self._entities[-1], qos=qos))
        writer: DataWriter[IdlStruct] = self._entities[-1]
        return writer


#: `DataWriter.write` keeps the interpreter's lock until all is on the network; ctypes does not.
_dds_write = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p)(("dds_write", DDS._dll_handle))


def _write(writer: DataWriter[IdlStruct], data: bytes) -> None:
    padded = data.ljust((len(data) + 3) & ~3, b"\0")  # Cyclone DDS reads whole words
    sample = Sample(ctypes.cast(ctypes.c_char_p(padded), ctypes.c_void_p), len(padded))
    code = _dds_write(writer._ref, ctypes.addressof(sample))
    if code != DDSException.DDS_RETCODE_OK:
        raise PublishError(f"ROS 2 refuses a message on {writer.topic.name}: {DDSException(code)}")


#: The others have their ROS names in Cyclone DDS.
_BASE_TYPES: Final[Mapping[str, Any]] = {"bool": bool, "string": str, "octet": idl.byte}


@lru_cache
def _dds_type(name: str) -> type[IdlStruct]:
    """Return the DDS type of a ROS 2 type; final, as ROS 2's are, by which Cyclone checks messages and subscribers."""
    package, kind, short = name.split("/")
    fields = {field: _field_type(description) for field, description in TYPES.fielddefs[name][1]}
    return make_idl_struct(f"{short}_", f"{package}::{kind}::dds_::{short}_", fields)


def _field_type(description: Any) -> Any:
    kind, argument = description
    if kind == Nodetype.BASE:
        return _BASE_TYPES.get(argument[0]) or getattr(idl, argument[0])
    if kind == Nodetype.NAME:
        return _dds_type(argument)
    element, count = _field_type(argument[0]), argument[1]
    array: Any = idl.array
    sequence: Any = idl.sequence
    if kind == Nodetype.ARRAY:
        return array[element, count]
    return sequence[element, count] if count else sequence[element]


def _receive_loopback_only(domain: int) -> None:
    """Bind a domain's sockets to the loopback device: Cyclone DDS receives on all, whichever interface it is given."""
    if sys.platform != "linux":
        return
    ports = range(7400 + 250 * domain, 7400 + 250 * (domain + 1))
    for descriptor in Path("/proc/self/fd").iterdir():
        if not descriptor.is_socket():
            continue
        try:
            number = os.dup(int(descriptor.name))
        except OSError:  # closed meanwhile by another thread
            continue
        with socket.socket(fileno=number) as copy:
            if copy.family != socket.AF_INET or copy.getsockname()[1] not in ports:
                continue
            try:
                copy.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo\0")
            except PermissionError as error:  # Linux before 5.7
                raise PublishError(
                    "this version of Linux lets only root limit it to this computer; "
                    "give the address of a network interface"
                ) from error
