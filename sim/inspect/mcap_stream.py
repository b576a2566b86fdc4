"""The bytes of an MCAP file: a stream that gives what was asked for or says that the file is cut, and chunks unpacked."""

import io

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.records import Chunk

MIB = 1 << 20
MOST_RECORD = 64 * MIB  # of the file, and of a decompressed chunk; writers end a chunk at 1 to 8 MiB


class ExactStream(ReadDataStream):
    """The bytes of one record. A length beyond its end is an error, where the library takes what there is."""

    def __init__(self, content: bytes) -> None:
        super().__init__(io.BytesIO(content))
        self._end = len(content)

    def read(self, length: int) -> bytes:
        """The next bytes, all of them.

        Raises:
            EndOfFile: there are fewer.
        """
        if length > self._end - self.count:
            raise EndOfFile
        return super().read(length)


def decompressed(chunk: Chunk) -> bytes | None:
    """A chunk's records, at most one byte more than it says; None where it is not compressed as it says."""
    most = chunk.uncompressed_size + 1
    try:
        if chunk.compression == "":
            return chunk.data
        if chunk.compression == "zstd":
            # Streaming: in one go it would allocate what the frame's own header says.
            return zstandard.ZstdDecompressor(max_window_size=MOST_RECORD).stream_reader(chunk.data).read(most)
        if chunk.compression == "lz4":
            return lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, most)
    except (zstandard.ZstdError, RuntimeError, EOFError):
        pass
    return None
