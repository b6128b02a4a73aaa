"""Run programs in processes that have imported ``usnet_env`` and nothing else: copies of one, which takes a second.

As a script, this is that process. It reads a program from each line of standard input, as JSON, runs it in a copy of
itself, and writes a line with the exit status and what the program printed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import usnet_env  # noqa: F401


class FreshProcess:
    """Starts the process with the first program."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def run(self, program: str, folder: Path | None = None) -> str:
        """Return what a program prints; a traceback, or another end with an error, fails the test.

        Args:
            program: its source.
            folder: the current folder, from which it imports, too.
        """
        if self._process is None or self._process.poll() is not None:
            words = [sys.executable, __file__]
            self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        request = {"program": program, "folder": str(folder or Path.cwd())}
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        status, out, err = json.loads(self._process.stdout.readline())
        assert status == 0, err
        return out

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.communicate()


def run_here(program: str) -> None:
    """Run a program and end this process."""
    status = 1
    try:
        exec(compile(program, "<program>", "exec"), {"__name__": "__main__"})
        status = 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def serve() -> None:
    """Answer requests until standard input ends."""
    sys.path[0] = ""  # the current folder, as for `python -c`
    for line in sys.stdin:
        request = json.loads(line)
        pipes = [os.pipe() for _ in range(2)]
        child = os.fork()
        if child == 0:
            os.chdir(request["folder"])
            for stream, (reading, writing) in enumerate(pipes, start=1):
                os.close(reading)
                os.dup2(writing, stream)
                os.close(writing)
            run_here(request["program"])
        texts = []
        for _, writing in pipes:
            os.close(writing)
        for reading, _ in pipes:  # one after the other: what is printed fits a pipe
            with open(reading, encoding="utf-8") as pipe:
                texts.append(pipe.read())
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        print(json.dumps([status, *texts]), flush=True)


if __name__ == "__main__":
    serve()
