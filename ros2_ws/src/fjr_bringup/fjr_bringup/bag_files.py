# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: MCAP, SQLite, and what rosbag2 compressed as a whole; each read as far as it goes.

An MCAP file is read front to back, so the file of a run that was killed (no index, no metadata.yaml, a torn last
record) gives everything up to the last flushed chunk. So does a SQLite file, without metadata.yaml or not.
"""

from __future__ import annotations

import sqlite3
import struct
import tempfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import yaml
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.records import Channel, DataEnd, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader, AnyReaderError

from fjr_bringup.bag_topic import BagError, Topic, Topics, topic_of
from fjr_bringup.schemas import typestore


def read_mcap(path: Path, topics: Topics) -> bool:
    """Add the messages of a file to `topics`; true when the file ends as a closed file does. Raises BagError."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Topic] = {}
    with open(path, "rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Message):
                    channels[record.channel_id].messages.append(record)
                elif isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    schema = schemas[record.schema_id]
                    channels[record.id] = topic_of(topics, record.topic, schema.name, schema.data.decode())
                elif isinstance(record, DataEnd):
                    return True
        except (EndOfFile, struct.error):
            return False  # torn at the end by a kill: all before it is good
        except InvalidMagic:
            raise BagError(f"{path} is not an MCAP file: it begins with other bytes") from None
        except (McapError, KeyError) as error:
            if not any(topic.messages for topic in topics.values()):
                raise BagError(f"{path} is not a readable MCAP file: {error or type(error).__name__}") from error
    return False


def read_sqlite(path: Path, topics: Topics) -> bool:
    """The same of a SQLite file, which knows one time of each message: when it was received."""
    whole = _read_tables(path, topics)
    if not whole and not any(topic.messages for topic in topics.values()):
        with tempfile.TemporaryDirectory() as folder:  # a file that was cut off is refused as it is
            _read_tables(_mended(path, Path(folder)), topics)
    for topic in topics.values():
        topic.messages.sort(key=lambda message: message.log_time)
    return whole


def _read_tables(path: Path, topics: Topics) -> bool:
    """Add what can be read; false where the end is missing. Raises BagError for what is no SQLite bag."""
    numbers: dict[int, Topic] = {}
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
            for number, name, type_name in database.execute("SELECT id, name, type FROM topics"):
                numbers[number] = topic_of(topics, name, type_name, "")
            for number, time, data in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
                numbers[number].messages.append(Message(number, time, data, time, 0))
    except sqlite3.DatabaseError as error:
        if "malformed" in str(error):
            return False
        raise BagError(f"{path} is not a readable SQLite bag: {error}") from error
    return True


def _mended(path: Path, folder: Path) -> Path:
    """A copy whose header says the number of pages that there are."""
    content = bytearray(path.read_bytes())
    page = int.from_bytes(content[16:18], "big") or 1
    content[28:32] = (len(content) // page).to_bytes(4, "big")
    copy = folder / path.name
    copy.write_bytes(content[: len(content) // page * page])
    return copy


def read_compressed(folder: Path, topics: Topics) -> bool:
    """The same of a whole folder that rosbag2 compressed, by the rosbags library."""
    try:
        with AnyReader([folder], default_typestore=typestore()) as reader:
            for connection, time, data in reader.messages():
                topic = topic_of(topics, connection.topic, connection.msgtype, connection.msgdef.data)
                topic.messages.append(Message(connection.id, time, data, time, 0))
    except (AnyReaderError, OSError) as error:
        raise BagError(f"{folder} is not a readable compressed bag: {error}") from error
    return True


READERS: dict[str, Callable[[Path, Topics], bool]] = {".mcap": read_mcap, ".db3": read_sqlite}


def files_of(path: Path) -> list[Path]:
    """The files of a bag, given by its folder, by one of its files or by the folder of a run; raises BagError."""
    if not path.exists():
        raise BagError(f"{path} does not exist; expected the folder of a bag or of a run, or an .mcap or .db3 file")
    if path.is_file():
        if path.suffix in READERS:
            return [path]
        raise BagError(f"{path} is not a bag: expected an .mcap or .db3 file, or a folder that holds some")
    if _is_compressed(path):
        return [path]
    files = sorted(file for suffix in READERS for file in path.glob(f"*{suffix}"))
    if files:
        return files
    raise BagError(f"{path} is not a bag: expected a folder with .mcap or .db3 files in it, or such a file")


def _is_compressed(folder: Path) -> bool:
    """Whether rosbag2 compressed the files of a bag, or each message."""
    try:
        found = yaml.safe_load((folder / "metadata.yaml").read_text(encoding="utf-8"))
        return bool(found["rosbag2_bagfile_information"].get("compression_mode", ""))
    except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError, AttributeError):
        return False


def read_file(path: Path, topics: Topics) -> bool:
    """Add the messages of one of files_of; true when it was closed as it should be."""
    if path.is_file() and path.stat().st_size == 0:
        return False
    return READERS.get(path.suffix, read_compressed)(path, topics)
