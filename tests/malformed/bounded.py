"""A reader of files in bounded memory and time, as a test sees it; the process behind it is :mod:`.reader`."""

import json
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


class Bounded:
    """A process that reads files; as a context it ends with it."""

    def __enter__(self) -> "Bounded":
        paths = [str(HERE.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(HERE / "reader.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"},
        )
        return self

    def read(self, reader: str, path: Path, temporary: Path) -> dict:
        """Outcome, message and peak of memory (bytes) of reading a file; temporary files go where they are to go."""
        request = {"reader": reader, "path": str(path), "temporary": str(temporary)}
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()
