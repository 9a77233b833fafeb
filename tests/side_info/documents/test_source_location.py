"""Errors show the line and the place."""

from side_info.documents.source_location import Excerpt, error_at


def test_line_column_and_caret() -> None:
    error = error_at("file", "one\ntwo three\n", 8, "problem")
    assert str(error) == "file:2:5: problem\n  two three\n      ^"


def test_the_end_of_a_text_has_a_place() -> None:
    assert str(Excerpt.alone("abc", "file").error(99, "problem")) == "file:1:4: problem\n  abc\n     ^"


def test_what_a_terminal_would_obey_is_not_shown() -> None:
    assert str(error_at("file", "a\x1b[31m\tb", 6, "problem")) == "file:1:7: problem\n  a [31m b\n        ^"


def test_of_a_long_line_the_part_around_the_place_is_shown() -> None:
    _, shown, caret = str(error_at("file", "x" * 500 + "!" + "y" * 500, 500, "problem")).split("\n")
    assert len(shown) < 110
    assert shown[caret.index("^")] == "!"


def test_the_place_of_a_character_of_an_excerpt() -> None:
    excerpt = Excerpt("cd", "file", "a\nbcd", (3, 4, 5))
    assert [excerpt.place(at) for at in (0, 1, 2, 9)] == [(2, 2), (2, 3), (2, 4), (2, 4)]
    assert str(excerpt.error(1, "problem")).startswith("file:2:3: ")
