"""Writes the flight record: every message of the bus, in one folder, without delaying the flight.

A caller only appends a message to a bounded queue. A thread encodes the queued messages ten times a
second and writes a chunk once a second, so a crash loses at most one second. A full disk, or a file
that somebody removes, ends the record with an event, but not the flight.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import io
import os
import platform
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import IO, Any, NamedTuple, TextIO

import msgspec
from mcap.writer import Writer

from groundstation.recording.channels import json_schema, rows
from onboard.bus.schema import Event, Message, Order, OrderReply
from onboard.bus.topics import Topic
from onboard.plain_text import plain_line

WRITE_PERIOD_S = 0.1
FLUSH_PERIOD_S = 1.0
SLOWEST_DISK_S = 10.0  # longest wait until the disk has taken what was recorded
MAX_QUEUED = 20_000
RECORD_NAME = "flight.mcap"
MADE_BY = "covey"  # name of the metadata about the program that wrote the record
MAX_CHANNELS = 4_000  # a hundred vehicles have a thousand; MCAP allows no more than 65,535
_CHUNK_BYTES = 512 * 1024  # smaller chunks would need more space for their indexes

_Item = tuple[Topic, str, Message, int]  # topic, name, message, time of its reception [ns]


class RecordEnd(NamedTuple):
    """How a record has ended, or how much of it is on the disk so far."""

    begin_ns: int  # time on the ground's clock from which the seconds of the record count
    written: int = 0  # number of messages on the disk
    dropped: int = 0  # number of messages that it lacks, because the disk was too slow
    failure: str | None = None  # why it ended early; None if it did not


def _made_by(begin: str) -> dict[str, str]:
    """Return the metadata about the program and the computer that write a record."""
    try:
        covey = version("covey")
    except PackageNotFoundError:
        covey = "not installed"
    return {
        "covey": covey,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "begin": begin,
    }


class RecordWriter:
    """Writes ``flight.mcap``, ``events.txt`` and ``orders.txt`` into a folder.

    Args:
        folder: the folder, which :meth:`start` creates.
        on_failure: called once, on the writer's thread or that of :meth:`stop`, with a sentence if
            the record had to end.
        on_warning: called on the writer's thread, with a sentence about something that is not
            recorded.
        open_file: opens the record's file; tests replace it.
    """

    def __init__(
        self,
        folder: Path,
        *,
        on_failure: Callable[[str], None] = lambda sentence: None,
        on_warning: Callable[[str], None] = lambda sentence: None,
        open_file: Callable[[Path], IO[bytes]] = lambda path: path.open("wb"),
    ) -> None:
        self.folder = folder
        self.dropped = 0  # number of messages that were dropped because the queue was full
        self.written = 0  # number of messages on the disk
        self.failure: str | None = None  # why the record had to end
        self.begin_ns = 0  # time on the ground's clock from which the record's seconds count
        self.on_failure = on_failure
        self._on_warning = on_warning
        self._open_file = open_file
        self._queue: deque[_Item] = deque()
        self._counting = threading.Lock()  # held while a message is counted as queued or dropped
        self._queued = 0  # number of messages that were put into the queue
        self._synced = 0  # number of those that are on the disk
        self._is_ended = threading.Event()
        self._thread: threading.Thread | None = None
        self._has_warned = False  # of dropped messages

    def start(self) -> None:
        """Create the folder and its files, and start the thread; a second call does nothing.

        Raises:
            OSError: the folder or its files cannot be created.
        """
        if self._thread is not None:
            return

        self.folder.mkdir(parents=True, exist_ok=True)
        begin = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
        stream = self._open_file(self.folder / RECORD_NAME)
        self.begin_ns = time.monotonic_ns()
        files = RecordFiles(
            self.folder, stream, begin_ns=self.begin_ns, begin=begin, on_warning=self._on_warning
        )
        sync_folder(self.folder)

        self._thread = threading.Thread(target=self._run, args=(files,), name="record", daemon=True)
        self._thread.start()

    def put(self, topic: Topic, name: str, message: Message, received_ns: int) -> None:
        """Queue one message; any thread may call this.

        If the queue is full, because the writer is far behind, the message is dropped and counted.
        """
        if self.failure is not None or self._thread is None:
            return
        with self._counting:
            if len(self._queue) < MAX_QUEUED:
                self._queue.append((topic, name, message, received_ns))
                self._queued += 1
            else:
                self.dropped += 1

    @property
    def end(self) -> RecordEnd:
        """How the record has ended; while it is still written, what is on the disk."""
        return RecordEnd(
            begin_ns=self.begin_ns,
            written=self.written,
            dropped=self.dropped,
            failure=self.failure,
        )

    def end_so_far(self, timeout_s: float = SLOWEST_DISK_S) -> RecordEnd:
        """Wait until all messages that were put so far are on the disk; the record goes on.

        Args:
            timeout_s: longest wait [s]; messages that are not on the disk then count as dropped.

        Returns:
            What is on the disk.
        """
        queued = self._queued
        end_s = time.monotonic() + timeout_s
        while self._synced < queued and self.failure is None and time.monotonic() < end_s:
            time.sleep(WRITE_PERIOD_S)

        waiting = max(0, queued - self._synced)
        return self.end._replace(dropped=self.dropped + waiting)

    def stop(self, timeout_s: float = SLOWEST_DISK_S) -> None:
        """Write the rest and finish the files; a second call does nothing.

        Args:
            timeout_s: longest wait for the disk [s]; after it the record has failed.
        """
        thread = self._thread
        self._thread = None
        if thread is None:
            return

        self._is_ended.set()
        # The thread is a daemon, so a disk that hangs does not prevent the exit.
        thread.join(timeout_s)
        if thread.is_alive():
            self._fail(
                f"The end of the record was not written to {self.folder} within {timeout_s:g} s, "
                "because the disk is too slow. Record to a faster disk."
            )

    def _run(self, files: RecordFiles) -> None:
        """Write the waiting messages until the record ends; a failure ends the record only."""
        next_flush_s = time.monotonic() + FLUSH_PERIOD_S
        is_finished = False
        taken = 0  # number of messages that were taken from the queue
        try:
            while not self._is_ended.wait(WRITE_PERIOD_S):
                taken += self._write(files)
                self._warn_once_of_dropped()
                if time.monotonic() >= next_flush_s:
                    files.flush()
                    self.written = files.written
                    self._synced = taken
                    next_flush_s = time.monotonic() + FLUSH_PERIOD_S

            taken += self._write(files)
            files.finish()
            self.written = files.written
            self._synced = taken
            is_finished = True
        except OSError as error:
            self._fail(failure_sentence(self.folder, error))
        finally:
            # An exception other than OSError is our own mistake; its trace goes to the log.
            if not is_finished:
                self._fail(
                    "The record ended by a mistake of Covey's own. The flight goes on without it."
                )
            files.close()

    def _warn_once_of_dropped(self) -> None:
        if self.dropped and not self._has_warned:
            self._has_warned = True
            self._on_warning(
                "The disk is too slow for the record: messages are missing in it. Record to a "
                "faster disk."
            )

    def _fail(self, sentence: str) -> None:
        """Note the first failure, and report it."""
        if self.failure is None:
            self.failure = sentence
            self.on_failure(sentence)

    def _write(self, files: RecordFiles) -> int:
        """Write the messages that wait, and return their number."""
        waiting = len(self._queue)
        for _ in range(waiting):
            files.write(*self._queue.popleft())
        return waiting


class RecordFiles:
    """The open files of a record; every method may raise OSError.

    Args:
        folder: folder for the text files.
        stream: open file for the MCAP.
        begin_ns: time [ns] on the ground's clock from which the seconds in the text files count.
        begin: the same time in words.
        on_warning: called once, with a sentence, if there are too many channels.
    """

    def __init__(
        self,
        folder: Path,
        stream: IO[bytes],
        *,
        begin_ns: int,
        begin: str,
        on_warning: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._begin_ns = begin_ns
        self._on_warning = on_warning

        self._path = folder / RECORD_NAME
        self._stream = stream
        self._mcap = Writer(stream, chunk_size=_CHUNK_BYTES)
        self._mcap.start(library="covey")
        self._mcap.add_metadata(MADE_BY, _made_by(begin))
        self._schemas: dict[type[Message], int] = {}  # kind -> id of its schema
        self._channels: dict[str, int] = {}  # name -> id of the channel
        self._sequences: Counter[int] = Counter()  # id of a channel -> its next sequence number
        self._is_full = False  # whether a row was left out because there are too many channels

        self._texts: dict[str, TextIO] = {}
        for name in ("events.txt", "orders.txt"):
            self._texts[name] = (folder / name).open("w", encoding="utf-8")
            self._texts[name].write(f"# seconds since {begin}\n")

    @property
    def written(self) -> int:
        """Number of messages written so far."""
        return self._sequences.total()

    def write(self, topic: Topic, name: str, message: Message, received_ns: int) -> None:
        """Write one message of the bus."""
        for channel, kind, stamp_ns, data in rows(topic, name, message, received_ns):
            self.add_raw(channel, kind, stamp_ns, data)

        if isinstance(message, Event):
            self._line("events.txt", received_ns, event_line(message))
            if message.order_id:
                outcome: str = message.order_outcome
                if not outcome:
                    outcome = message.code
                text = f"{name} {message.order_id} {outcome}: {message.sentence}"
                self._line("orders.txt", received_ns, text)
        elif isinstance(message, Order):
            self._line("orders.txt", received_ns, order_line(name, message))
        elif isinstance(message, OrderReply):
            answer = "accepted" if message.is_accepted else "refused"
            text = f"{name} {message.order_id} {answer}: {message.reason}"
            self._line("orders.txt", received_ns, text)

    def add_raw(self, channel: str, kind: type[Message], stamp_ns: int, data: bytes) -> None:
        """Write one row of the record.

        When there are MAX_CHANNELS channels, rows of new channels are left out, with one warning.
        """
        channel_id = self._channels.get(channel)
        if channel_id is None:
            if len(self._channels) >= MAX_CHANNELS:
                self._warn_once_that_it_is_full(channel)
                return
            channel_id = self._register(channel, kind)

        self._mcap.add_message(channel_id, stamp_ns, data, stamp_ns, self._sequences[channel_id])
        self._sequences[channel_id] += 1

    def _warn_once_that_it_is_full(self, channel: str) -> None:
        if self._is_full:
            return
        self._is_full = True
        self._on_warning(
            f"The record has {MAX_CHANNELS} channels and takes no new names, for instance "
            f"{plain_line(channel)[:60]}. Somebody floods the bus with names: find out who."
        )

    def flush(self) -> None:
        """Bring all messages so far to the disk, so that a power cut loses at most a second."""
        # This ends the chunk although it is not full. Few vehicles take a minute to fill a chunk.
        self._mcap.flush()  # type: ignore[no-untyped-call]
        for file in self._files():
            file.flush()
            with contextlib.suppress(io.UnsupportedOperation):  # a file in memory has no descriptor
                os.fdatasync(file.fileno())
        self._refuse_removed_file()

    def _refuse_removed_file(self) -> None:
        """Raise FileNotFoundError if the record's file was removed or renamed.

        The disk goes on to take what is written into it, and loses it when the file is closed.
        """
        with contextlib.suppress(io.UnsupportedOperation):
            try:
                named = os.stat(self._path)
            except FileNotFoundError:
                named = None
            except OSError:  # whether it is there is not known
                return
            own = os.fstat(self._stream.fileno())
            # another file may have its name now; some disks do not number their files
            if named is None or (own.st_ino and named.st_ino and not os.path.samestat(named, own)):
                raise FileNotFoundError(errno.ENOENT, f"somebody has removed {RECORD_NAME}")

    def _files(self) -> tuple[IO[Any], ...]:
        return (self._stream, *self._texts.values())

    def finish(self) -> None:
        """Write the end of the files."""
        self._mcap.finish()  # type: ignore[no-untyped-call]
        for file in self._files():
            file.flush()
        self._refuse_removed_file()

    def close(self) -> None:
        """Close all files, finished or not."""
        for file in self._files():
            with contextlib.suppress(OSError):  # the failure itself has been reported
                file.close()

    def _register(self, name: str, kind: type[Message]) -> int:
        """Begin a channel; return its id."""
        if kind not in self._schemas:
            self._schemas[kind] = self._mcap.register_schema(
                f"covey.{kind.__name__}", "jsonschema", json_schema(kind)
            )
        self._channels[name] = self._mcap.register_channel(name, "json", self._schemas[kind])
        return self._channels[name]

    def _line(self, name: str, received_ns: int, text: str) -> None:
        seconds = (received_ns - self._begin_ns) * 1e-9
        self._texts[name].write(f"{seconds:9.3f} {plain_line(text)}\n")


def failure_sentence(folder: Path, error: OSError) -> str:
    """Return a sentence about a record that cannot be written."""
    reason = error.strerror or error
    advice = "Free some space before the next one."
    if isinstance(error, FileNotFoundError):
        advice = "Leave the folder of the next one where it is."
    return (
        f"The record ended: {folder} cannot be written ({reason}). "
        f"The flight goes on without it. {advice}"
    )


def event_line(event: Event) -> str:
    """Return an event as one line of text."""
    return plain_line(f"{event.vehicle} {event.severity} {event.code}: {event.sentence}")


def order_line(vehicle: str, order: Order) -> str:
    """Return an order as one line of text."""
    text = f"{vehicle} {order.order_id} ordered by {order.author}: {order.kind}"
    if order.position_enu_m is not None:
        axes = " ".join(f"{axis_m:.3f}" for axis_m in order.position_enu_m)
        text += f" to {axes}"
    if order.height_m is not None:
        text += f" to {order.height_m:.2f} m"
    if order.duration_s:
        text += f" in {order.duration_s:g} s"
    return text


def sync_folder(folder: Path) -> None:
    """Bring the names of new files to the disk, so that a power cut does not lose the files.

    Raises:
        OSError: the disk refuses.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_json(path: Path, value: object) -> str | None:
    """Write a value as readable JSON, whole or not at all.

    Args:
        path: path of the file.
        value: any value that msgspec can encode.

    Returns:
        None, or a sentence if the file cannot be written.
    """
    part = path.with_suffix(".part")
    text = msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n"
    try:
        with part.open("wb") as stream:
            stream.write(text)
            stream.flush()
            # before the rename, so that a power cut leaves no empty file under the final name
            os.fsync(stream.fileno())
        part.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        return f"{path} cannot be written ({error.strerror or error})."
    return None
