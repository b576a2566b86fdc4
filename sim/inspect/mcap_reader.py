"""An MCAP file, read with suspicion: whoever wrote it may have been cut off, a disk may have flipped bits, or worse.

Format: https://mcap.dev/spec. The file is walked from its beginning, record by record. Its index is never asked, no length is
believed that the file itself does not bear out, and nothing is decompressed beyond what is allowed. What cannot be read is left
out, and said. The library's own readers are for files that one trusts: they ask for as much memory as a length field says, and
decompress without a limit. Its records read themselves here, each from bytes of its own that it cannot look beyond.
"""

import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, TypeVar

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, McapRecord, Metadata, Schema

from models.common.errors import InputError
from models.common.files import reading
from sim.inspect.mcap_contents import MIB, MOST_RECORD, Attached, Channels, ExactStream, McapContents, decompressed

GIVE = "give an .mcap file that a run has written"
MAGIC = b"\x89MCAP0\r\n"
MOST_KEPT = 256 * MIB  # of metadata and attachments together
MOST_DATA = 4096 * MIB  # of all decompressed chunks together; a million samples of a full car take 900 MiB
GROWTH = 200  # times the file's own size, for the same; a vehicle at rest on a flat road, all zeros, compresses 40 times
MOST_DAMAGE = 20  # remarks; of more, only the number

PLAIN = (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.MESSAGE_INDEX)
_HEAD = struct.Struct("<BQ")
_BROKEN = (McapError, ValueError, struct.error)  # what a record's own reader may raise

AnyRecord = TypeVar("AnyRecord", bound=McapRecord)


def read_mcap(path: Path) -> McapContents:
    """Reads a regular file as far as it can be read.

    Raises:
        InputError: it cannot be opened, or is no MCAP file.
    """
    with reading(path, "log", GIVE), path.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise InputError(f"no MCAP file; {GIVE}")
        reader = _Reader(os.fstat(stream.fileno()).st_size)
        reader.read(stream)
    return reader.found()


class _Reader:
    """Collects what a file holds. All its bounds are in one place, `_budget`, or beside the read that they bound."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._budget = min(MOST_DATA, GROWTH * size + MIB)
        self._kept = 0
        self._metadata: dict[str, Mapping[str, str]] = {}
        self._attachments: dict[str, Attached] = {}
        self._damage: dict[str, None] = {}  # in order, each once
        self._channels = Channels(self._damaged)
        self._chunks = self._right = self._absent = 0

    def read(self, stream: BinaryIO) -> None:
        """The whole file, from behind its magic."""
        for opcode, offset, content in self._records(stream):
            where = f"at byte {offset}"
            if opcode == Opcode.METADATA:
                self._keep_metadata(where, content)
            elif opcode == Opcode.ATTACHMENT:
                self._keep_attachment(where, content)
            elif opcode == Opcode.CHUNK:
                self._read_chunk(where, content)
            elif opcode in PLAIN:
                self._read_inner(where, opcode, memoryview(content))
            else:
                self._damaged(f"the {_name(opcode)} {where} is none that a run of ours writes")

    def found(self) -> McapContents:
        """Returns the contents read so far."""
        damage = list(self._damage)
        if len(damage) > MOST_DAMAGE:
            damage = [*damage[:MOST_DAMAGE], f"and {len(damage) - MOST_DAMAGE} more of the kind"]
        counts = self._chunks, self._channels.messages, self._right, self._absent
        logged, schemas = self._channels.logged(), self._channels.schema_names
        return McapContents(self._metadata, self._attachments, logged, schemas, *counts, tuple(damage))

    def _damaged(self, remark: str) -> None:
        if len(self._damage) < 1000 * MOST_DAMAGE:
            self._damage[remark] = None

    def _records(self, stream: BinaryIO) -> Iterator[tuple[int, int, bytes]]:
        """Opcode, place and content of the records of the data section; checks what follows it."""
        offset, checksum, data = len(MAGIC), zlib.crc32(MAGIC), True
        while True:
            head = stream.read(_HEAD.size)
            if len(head) < _HEAD.size:
                self._damaged(f"cut short: it ends at byte {self._size}, before its last record")
                return
            opcode, length = _HEAD.unpack(head)
            left = self._size - offset - _HEAD.size
            if length > left:
                self._damaged(f"cut short: of the {_name(opcode)} at byte {offset}, {length} bytes, {max(left, 0)} are there")
                return
            if length > MOST_RECORD:
                self._damaged(f"the {_name(opcode)} at byte {offset} has {length} bytes, more than the {MOST_RECORD} allowed")
                checksum = zlib.crc32(head, checksum)
                for start in range(0, length, MIB):
                    checksum = zlib.crc32(stream.read(min(MIB, length - start)), checksum)
                offset += _HEAD.size + length
                continue
            content = stream.read(length)
            if opcode == Opcode.FOOTER:
                self._check_end(content, zlib.crc32(content[:16], zlib.crc32(head, checksum)), stream.read(len(MAGIC) + 1), data)
                return
            if opcode == Opcode.DATA_END and data:
                self._check_data(content, checksum)
                checksum, data = 0, False
            else:
                checksum = zlib.crc32(content, zlib.crc32(head, checksum))
                if data:  # behind it, copies and indexes
                    yield opcode, offset, content
            offset += _HEAD.size + length

    def _check_data(self, content: bytes, checksum: int) -> None:
        """The end of the data section: its checksum is over everything before."""
        end = self._parsed(DataEnd, "at the end of its data", content)
        if end is not None and not self._sound(end.data_section_crc, checksum):
            self._damaged("changed since it was written: the checksum over all its data is wrong")

    def _check_end(self, content: bytes, checksum: int, magic: bytes, data: bool) -> None:
        """The end of the file: its checksum is over everything behind the data."""
        footer = self._parsed(Footer, "at its end", content)
        if data:
            self._damaged("its data have no end")
        elif footer is not None and not self._sound(footer.summary_crc, checksum):
            self._damaged("changed since it was written: the checksum over its index is wrong")
        if magic != MAGIC:
            self._damaged("it does not end as an MCAP file does")

    def _sound(self, given: int, computed: int) -> bool:
        """Returns True if a checksum is right or absent, and counts it: zero means absent, unless it is the checksum itself."""
        self._right += given == computed
        self._absent += given == 0 != computed
        return given in (0, computed)

    def _keep(self, where: str, size: int) -> bool:
        self._kept += size
        if self._kept > MOST_KEPT:
            self._damaged(f"metadata and attachments take more than {MOST_KEPT} bytes; what comes {where} and later is not read")
        return self._kept <= MOST_KEPT

    def _keep_metadata(self, where: str, content: bytes) -> None:
        record = self._parsed(Metadata, where, content)
        if record is None or not self._keep(where, len(content)):
            return
        if record.name in self._metadata:
            self._damaged(f"the metadata {where} have a name that others have already")
        else:
            self._metadata[record.name] = record.metadata

    def _keep_attachment(self, where: str, content: bytes) -> None:
        record = self._parsed(Attachment, where, content)
        if record is None or not self._keep(where, len(content)):
            return
        if not self._sound(int.from_bytes(content[-4:], "little"), zlib.crc32(content[:-4])):
            self._damaged(f"the attachment {where} is damaged: its checksum is wrong")
        elif record.name in self._attachments:
            self._damaged(f"the attachment {where} has a name that another has already")
        else:
            self._attachments[record.name] = Attached(record.media_type, (record.create_time, record.log_time), record.data)

    def _read_chunk(self, where: str, content: bytes) -> None:
        chunk = self._parsed(Chunk, where, content)
        if chunk is None:
            return
        lost = f"; its messages, from {chunk.message_start_time / 1e9:g} to {chunk.message_end_time / 1e9:g} s, are lost"
        size = chunk.uncompressed_size
        if size > min(MOST_RECORD, self._budget):
            self._damaged(f"the chunk {where} grows to {size} bytes when decompressed, beyond what is allowed{lost}")
            return
        self._budget -= size
        data = decompressed(chunk)
        if data is None or len(data) != size or not self._sound(chunk.uncompressed_crc, zlib.crc32(data)):
            self._damaged(f"the chunk {where} is damaged{lost}")
            return
        self._chunks += 1
        position, records = 0, memoryview(data)
        while position < size:
            if position + _HEAD.size > size:
                self._damaged(f"the chunk {where} ends within a record")
                return
            opcode, length = _HEAD.unpack_from(records, position)
            position += _HEAD.size
            if length > size - position:
                self._damaged(f"the chunk {where} ends within a record")
                return
            self._read_inner(where, opcode, records[position : position + length])
            position += length

    def _read_inner(self, where: str, opcode: int, content: memoryview) -> None:
        """A record that may stand in a chunk."""
        if opcode == Opcode.MESSAGE:
            self._channels.add_message(where, content)
        elif opcode == Opcode.SCHEMA:
            schema = self._parsed(Schema, where, bytes(content))
            if schema is not None:
                self._channels.add_schema(where, schema)
        elif opcode == Opcode.CHANNEL:
            channel = self._parsed(Channel, where, bytes(content))
            if channel is not None:
                self._channels.open(where, channel)
        elif opcode not in PLAIN:
            self._damaged(f"the {_name(opcode)} {where} is none that a run of ours writes")

    def _parsed(self, kind: type[AnyRecord], where: str, content: bytes) -> AnyRecord | None:
        try:
            return kind.read(ExactStream(content))  # pyright: ignore[reportAttributeAccessIssue] - those used here have it
        except _BROKEN:
            self._damaged(f"the {kind.__name__.lower()} {where} is no such record")
            return None


def _name(opcode: int) -> str:
    """Returns the name of a record type."""
    known = {code.value: code.name.lower().replace("_", " ") for code in Opcode}
    return f"{known.get(opcode, 'unknown')} record"
