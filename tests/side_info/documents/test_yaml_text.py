"""The strict subset of YAML."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.errors import ScenarioError
from side_info.documents.yaml_text import MAX_BYTES, read_yaml


def test_plain_scalars() -> None:
    text = 'a: [1, -2.5, 1e3, 1:30, no, "1", true, null, 2026-05-01, 0x10, 1_000, 9999999999999999999, ]'
    assert read_yaml(text, "test").fields == {
        "a": [1, -2.5, 1000.0, "1:30", "no", "1", True, None, "2026-05-01", "0x10", "1_000", 1e19]
    }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "test:1:1: the document is empty"),
        ("# only a comment", "the document is empty"),
        ("[" * 20_000, "nested too deeply"),
        ("a: " + "x" * MAX_BYTES, "expected at most"),
        ("a: &a [*a]", "test:1:4: not YAML: anchors and aliases are not allowed"),
        ("a: &a {b: c}", "test:1:4: not YAML: anchors and aliases are not allowed"),
        ("a: [b", "test:1:6: not YAML"),
        ("a: \ud800", "test:1:4: not YAML"),
    ],
)
def test_refusals(text: str, words: str) -> None:
    with pytest.raises(ScenarioError) as refused:
        read_yaml(text, "test")
    assert words in str(refused.value)


@given(st.text(st.sampled_from("ab :,{}[]\"'|>-\n\\#&*!?%@`0.1\t"), max_size=40))
def test_every_character_of_an_excerpt_has_its_place(text: str) -> None:
    try:
        document = read_yaml(text, "test")
    except ScenarioError:
        return
    for path, value in document.values.items():
        if not isinstance(value.value, str):
            continue
        excerpt = document.excerpt(path)
        assert len(excerpt.offsets) == len(excerpt.text) + 1
        assert all(0 <= offset <= len(text) for offset in excerpt.offsets)
        if len(set(excerpt.offsets)) > 1:
            shown = [text[offset] for offset in excerpt.offsets[:-1]]
            pairs = zip(shown, excerpt.text, strict=True)
            assert all(there == here for there, here in pairs if not here.isspace())
