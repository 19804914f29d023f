"""Body files for tests."""

import pytest


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "arm.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write
