"""The flight record of a lockstep flight: the same files as in real time, written without a thread.

Each message is written when it arrives, because in simulated time slow disks do not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from groundstation.recording.writer import RECORD_NAME, RecordEnd, RecordFiles, failure_sentence
from onboard.bus.schema import Message
from onboard.bus.topics import Topic


class LockstepRecord:
    """Writes ``flight.mcap``, ``events.txt`` and ``orders.txt``.

    Args:
        folder: the folder of the files, which is created.
        begin_ns: the time from which the seconds in the text files count.
        say: called with severity, code and sentence of an event: once if writing fails, and once if
            there are too many channels.

    Raises:
        OSError: the folder cannot be created.
    """

    def __init__(
        self, folder: Path, begin_ns: int, *, say: Callable[[str, str, str], None]
    ) -> None:
        self.folder = folder
        self._begin_ns = begin_ns
        self._say = say
        self.failure: str | None = None  # a sentence, if the record ended early
        self.written = 0  # number of messages on the disk

        folder.mkdir(parents=True, exist_ok=True)
        stream = (folder / RECORD_NAME).open("wb")
        self._files: RecordFiles | None = RecordFiles(
            folder,
            stream,
            begin_ns=begin_ns,
            begin="the start, simulated",
            on_warning=lambda sentence: say("warning", "record_full", sentence),
        )

    def put(self, topic: Topic, name: str, message: Message, received_ns: int) -> None:
        """Write one message."""
        if self._files is None:
            return
        try:
            self._files.write(topic, name, message, received_ns)
        except OSError as error:
            self.fail(error)

    @property
    def end(self) -> RecordEnd:
        """How the record has ended."""
        return RecordEnd(begin_ns=self._begin_ns, written=self.written, failure=self.failure)

    def stop(self) -> None:
        """Finish the files; a second call does nothing."""
        files = self._files
        if files is None:
            return

        try:
            files.finish()
            self.written = files.written
        except OSError as error:
            self.fail(error)
        self._files = None
        files.close()

    def fail(self, error: OSError) -> None:
        """End the record after a failure of the disk, and report it once.

        Args:
            error: what happened while a file of the record's folder was written.
        """
        files = self._files
        self._files = None
        if files is None:
            return

        files.close()
        self.failure = failure_sentence(self.folder, error)
        self._say("critical", "record_failed", self.failure)
