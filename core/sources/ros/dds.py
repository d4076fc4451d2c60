"""DDS as ROS 2 uses it, without a ROS installation, by Eclipse Cyclone DDS: its domains, types and topics.

Topics, type names and settings are those of ROS 2 (its middleware names topic ``/a`` ``rt/a``, type ``pkg/msg/Name``
``pkg::msg::dds_::Name_``), so nodes with Fast DDS or Cyclone DDS see a node like any other. Messages stay bytes
(CDR) here: Cyclone's own decoding would make a list of the bytes of every image.
"""

from __future__ import annotations

import ctypes
import ipaddress
import os
import socket
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from rosbags.interfaces import Nodetype

from ...errors import MissingExtraError
from .messages import TRANSFORMS, TYPES

try:
    from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
    from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.idl import IdlStruct, make_idl_struct
    from cyclonedds.idl import types as idl
    from cyclonedds.internal import DDS
    from cyclonedds.pub import DataWriter
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Sample, Topic
except ImportError as missing:
    raise MissingExtraError(
        "ROS 2 needs cyclonedds: install it with pip install 'tactune[live]'; on Linux on ARM, where it has no wheel, "
        "install Cyclone DDS 11 first, then cyclonedds by pip; Foxglove works without it"
    ) from missing

#: Largest domain id whose ports exist.
MAX_DOMAIN: Final = 232
#: Messages of a topic that wait for a busy reader.
_QUEUE: Final = 8
#: More than there are publishers.
_ALL: Final = 10_000

#: Announcing every second finds others quickly. Lost parts are repeated all at once and after milliseconds; with
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
#: mallopt's parameters of the GNU C library, and the size of what is kept.
_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3
_KEPT_BYTES: Final = 32 << 20

#: Few large datagrams, which no network card limits. Others are also addressed one by one, since some listen to
#: multicast of network cards only.
_LOOPBACK: Final = {
    "general": """\
<Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces><AllowMulticast>spdp</AllowMulticast>
    <MaxMessageSize>65500 B</MaxMessageSize><MaxRexmitMessageSize>65500 B</MaxRexmitMessageSize>
    <FragmentSize>63000 B</FragmentSize>""",
    "discovery": '<Peers><Peer address="127.0.0.1"/></Peers>',
}


def check_network(domain: int, host: str) -> ipaddress.IPv4Address:
    """Return the address of a network interface; `ValueError` with a clause if it or the domain is not valid."""
    if not 0 <= domain <= MAX_DOMAIN:
        raise ValueError(f"the ROS 2 domain id {domain} is not from 0 to {MAX_DOMAIN}; choose another")
    try:
        return ipaddress.IPv4Address(host)
    except ValueError:
        raise ValueError(f"{host!r} is no IPv4 address; give that of a network interface, or 0.0.0.0") from None


class Participant:
    """A member of a ROS 2 domain, as a node is.

    ``host`` is the address of the network interface: with ``127.0.0.1`` nothing leaves this computer and nothing from
    outside is received; with ``0.0.0.0`` Cyclone DDS chooses the interface, and ``CYCLONEDDS_URI`` applies.
    ``also_here`` adds the loopback interface. Raises `ValueError` with a clause if that is not possible.
    """

    def __init__(self, domain: int, host: str, *, also_here: bool = False) -> None:
        address = check_network(domain, host)
        self._entities: list[Any] = []  # in the order in which they need each other
        try:
            self._entities.append(Domain(domain, _config(address, also_here)))
        except DDSException as error:
            raise ValueError(
                f"there is no network interface {address}, or this program uses domain {domain} already; choose another"
            ) from error
        try:
            self._entities.append(DomainParticipant(domain))
            if address.is_loopback:
                _receive_loopback_only(domain)
        except (DDSException, ValueError) as error:
            self.close()
            raise ValueError(str(error)) from error
        self.participant: DomainParticipant = self._entities[1]

    def write(self, topic: str, kind: str, type_hash: str, history: int, is_kept: bool) -> Writer:
        """Announce a topic that repeats ``history`` messages, if ``is_kept`` to later readers; or `ValueError`."""
        qos = Qos(
            Policy.Reliability.Reliable(max_blocking_time=0),
            Policy.Durability.TransientLocal if is_kept else Policy.Durability.Volatile,
            Policy.History.KeepLast(history),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(f"typehash={type_hash};".encode()),
        )
        try:
            self._entities.append(Topic(self.participant, f"rt{topic}", dds_type(kind)))
            self._entities.append(DataWriter(self.participant, self._entities[-1], qos=qos))
        except DDSException as error:
            raise ValueError(str(error)) from error
        return Writer(self._entities[-1])

    def close(self) -> None:
        """Leave the domain; twice is harmless."""
        self.__dict__.pop("participant", None)
        while self._entities:
            del self._entities[-1]  # nothing else holds it: Cyclone's own is deleted with it


class Writer:
    """Publishes one topic; made by `Participant.write`."""

    def __init__(self, entity: DataWriter[Any]) -> None:
        self._entity = entity

    @property
    def subscribers(self) -> int:
        """How many read the topic now."""
        return len(self._entity.get_matched_subscriptions())

    def send(self, data: bytes) -> None:
        """Send a message, all of its CDR; `ValueError` if it is refused."""
        padded = data.ljust((len(data) + 3) & ~3, b"\0")  # Cyclone DDS reads whole words
        sample = Sample(ctypes.cast(ctypes.c_char_p(padded), ctypes.c_void_p), len(padded))
        code = _dds_write(self._entity._ref, ctypes.addressof(sample))
        if code != DDSException.DDS_RETCODE_OK:
            raise ValueError(str(DDSException(code)))


#: `DataWriter.write` keeps the interpreter's lock until all is on the network; ctypes does not.
_dds_write = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p)(("dds_write", DDS._dll_handle))


class Raw:
    """A message as it came: all of its CDR, with its four-byte header."""

    __slots__ = ("data", "sample_info")

    def __init__(self, data: bytes) -> None:
        self.data = data


class Reader:
    """Receives the messages of one topic; made by `Listener.read`."""

    def __init__(self, reader: DataReader[Any]) -> None:
        self.entity = reader

    def take(self) -> list[bytes]:
        """Return the messages that have come since, the oldest first; at most `_QUEUE` wait."""
        return [each.data for each in self.entity.take(N=_QUEUE) if isinstance(each, Raw)]


class Listener(Participant):
    """A participant that reads topics, also of the loopback interface: a publisher on this computer may use either."""

    def __init__(self, domain: int, host: str) -> None:
        super().__init__(domain, host, also_here=True)
        self.domain = domain
        self._publications = BuiltinDataReader(self.participant, BuiltinTopicDcpsPublication)

    def topics(self) -> dict[str, str]:
        """Return the topics of ROS 2 that are published, with their message types."""
        return {
            each.topic_name.removeprefix("rt"): each.type_name.replace("::dds_::", "::").replace("::", "/").rstrip("_")
            for each in self._published()
        }

    def close(self) -> None:
        self.__dict__.pop("_publications", None)
        super().close()

    def read(self, topic: str, kind: str) -> Reader:
        """Begin to receive a topic with repeats where its publishers offer them: else it would not be connected."""
        offers = [each.qos[Policy.Reliability] for each in self._published() if each.topic_name == f"rt{topic}"]
        is_repeated = bool(offers) and all(isinstance(offer, Policy.Reliability.Reliable) for offer in offers)
        is_kept = kind == TRANSFORMS
        qos = Qos(
            Policy.Reliability.Reliable(max_blocking_time=0) if is_repeated else Policy.Reliability.BestEffort,
            Policy.Durability.TransientLocal if is_kept else Policy.Durability.Volatile,
            Policy.History.KeepLast(_QUEUE),
        )
        return Reader(DataReader(self.participant, Topic(self.participant, f"rt{topic}", _raw_type(kind)), qos=qos))

    def _published(self) -> list[Any]:
        """Return what is announced about each publisher of a ROS 2 topic; those that left have no names."""
        announced = self._publications.read(N=_ALL)
        return [
            each
            for each in announced
            if (each.topic_name or "").startswith("rt/") and "::msg::dds_::" in (each.type_name or "")
        ]


class Waiter:
    """Waits until one of several topics has a message."""

    def __init__(self, listener: Listener, readers: Sequence[Reader]) -> None:
        self._set = WaitSet(listener.participant)
        for reader in readers:
            unread = SampleState.NotRead | ViewState.Any | InstanceState.Any
            self._set.attach(ReadCondition(reader.entity, unread))

    def wait(self, timeout_s: float) -> bool:
        return bool(self._set.wait(int(timeout_s * 1e9)))


def keep_freed_memory() -> None:
    """Keep the memory of a message for the next one: giving it back takes half of the time of receiving images."""
    with suppress(OSError, AttributeError):  # not the GNU C library
        for parameter in (_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD):
            ctypes.CDLL(None).mallopt(parameter, _KEPT_BYTES)


def _config(address: ipaddress.IPv4Address, also_here: bool) -> str:
    if address.is_loopback:
        return _CONFIG.format(**_LOOPBACK)
    choice = 'autodetermine="true"' if address.is_unspecified else f'address="{address}"'
    here = '<NetworkInterface address="127.0.0.1" multicast="true"/>' if also_here else ""
    general = f"<Interfaces><NetworkInterface {choice}/>{here}</Interfaces>"
    return ",".join((_CONFIG.format(general=general, discovery=""), os.environ.get("CYCLONEDDS_URI", "")))


#: The others have their ROS names in Cyclone DDS.
_BASE_TYPES: Final[Mapping[str, Any]] = {"bool": bool, "string": str, "octet": idl.byte}


@lru_cache
def dds_type(name: str) -> type[IdlStruct]:
    """Return the DDS type of a ROS 2 type; final, as ROS 2's are, by which Cyclone checks messages and subscribers."""
    package, kind, short = name.split("/")
    fields = {field: _field_type(description) for field, description in TYPES.fielddefs[name][1]}
    return make_idl_struct(f"{short}_", f"{package}::{kind}::dds_::{short}_", fields)


@lru_cache
def _raw_type(name: str) -> type[IdlStruct]:
    """Return the DDS type of a ROS 2 type whose messages stay bytes."""
    raw = dds_type.__wrapped__(name)
    raw.deserialize = classmethod(lambda cls, data, **_: Raw(data))  # type: ignore[method-assign, assignment]
    return raw


def _field_type(description: Any) -> Any:
    kind, argument = description
    if kind == Nodetype.BASE:
        return _BASE_TYPES.get(argument[0]) or getattr(idl, argument[0])
    if kind == Nodetype.NAME:
        return dds_type(argument)
    element, count = _field_type(argument[0]), argument[1]
    array: Any = idl.array
    sequence: Any = idl.sequence
    if kind == Nodetype.ARRAY:
        return array[element, count]
    return sequence[element, count] if count else sequence[element]


def _receive_loopback_only(domain: int) -> None:
    """Bind a domain's sockets to the loopback device: Cyclone DDS receives on all, whichever interface it is given."""
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
                raise ValueError(
                    "this Linux lets only root limit it to this computer; give a network interface's address"
                ) from error
