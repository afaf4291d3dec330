"""The promises of docs/threat_model.md and SECURITY.md that no other test covers."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_files_of_an_export_name_their_licence():
    for file in (ROOT / "rhec/embedded/c").iterdir():
        assert re.search("SPDX-License-Identifier: MIT", file.read_text()), file.name


def test_the_threat_model_names_tests_that_exist():
    text = (ROOT / "docs/threat_model.md").read_text()
    named = re.findall(r"`(tests/\S+)`", text)
    assert named
    for path in named:
        assert (ROOT / path).exists(), path
