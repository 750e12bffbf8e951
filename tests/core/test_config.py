from typing import Annotated, Literal

import pytest
from pydantic import Field

from gs2ci.core.config import MOST_TOLD, ConfigTable, read_settings, read_toml
from gs2ci.core.errors import InputError


class Cat(ConfigTable):
    kind: Literal["cat"]
    purrs: bool = True


class Dog(ConfigTable):
    kind: Literal["dog"]
    barks_per_s: float = Field(default=1.0, gt=0)


class House(ConfigTable):
    pet: Annotated[Cat | Dog, Field(discriminator="kind")]
    rooms: int = 3
    height_m: Annotated[float, Field(gt=0)] | None = None


def read(tmp_path, text):
    path = tmp_path / "house.toml"
    path.write_text(text)
    return read_settings(path, House)


def test_settings_are_returned(tmp_path):
    house = read(tmp_path, 'rooms = 4\n[pet]\nkind = "dog"\nbarks_per_s = 2.5\n')
    assert house == House(pet=Dog(kind="dog", barks_per_s=2.5), rooms=4)
    assert read(tmp_path, '[pet]\nkind = "cat"\npurrs = false\n').pet == Cat(kind="cat", purrs=False)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            '[pet]\nkind = "dog"\nbarks_per_sec = 2',
            r"unknown key 'barks_per_sec' in \[pet\]; did you mean 'barks_per_s'\?",
        ),
        (
            'rooms = 1\nroms = 2\n[pet]\nkind = "cat"',
            r"unknown key 'roms' in the top of the file; did you mean 'rooms'\?",
        ),
        ('[pet]\nkind = "cat"\nqqq = 1', r"unknown key 'qqq' in \[pet\]; known are kind, purrs"),
        ('[pet]\nkind = "bird"', r"unknown kind 'bird' in \[pet\]; allowed: 'cat', 'dog'"),
        ("[pet]\npurrs = true", r"key 'kind' is missing in \[pet\]; allowed: 'cat', 'dog'"),
        ("rooms = 3", r"key 'pet' is missing in the top of the file"),
        ('[pet]\nkind = "dog"\nbarks_per_s = -1.0', r"'barks_per_s' in \[pet\] is -1.0: .*greater than 0"),
        (
            'rooms = "two"\n[pet]\nkind = "cat"',
            r"'rooms' in the top of the file is 'two': it should be a whole number$",
        ),
        ('[pet]\nkind = "cats"', r"unknown kind 'cats' in \[pet\]; allowed: 'cat', 'dog'; did you mean 'cat'\?"),
        ('rooms = true\n[pet]\nkind = "cat"', r"house.toml: 'rooms' is true: it should be a number$"),
        ('height_m = true\n[pet]\nkind = "cat"', r"'height_m' is true: it should be a number$"),
        ('[pet]\nkind = "dog"\nbarks_per_s = true', r"\[pet\]: 'barks_per_s' is true: it should be a number$"),
        ("rooms = [", "is not TOML"),
    ],
)
def test_every_mistake_is_one_sentence_that_names_file_table_and_key(tmp_path, text, complaint):
    with pytest.raises(InputError, match=complaint) as caught:
        read(tmp_path, text)
    assert "house.toml" in str(caught.value)


def test_all_mistakes_are_named_at_once_on_a_line_each(tmp_path):
    with pytest.raises(InputError) as caught:
        read(tmp_path, 'roms = 2\n[pet]\nkind = "dog"\nbarks_per_sec = 2')
    first, *others = caught.value.problem.splitlines()
    assert first == f"{tmp_path / 'house.toml'}:"
    assert [line.split("'")[1] for line in others] == ["barks_per_sec", "roms"]


def test_of_many_mistakes_the_first_are_named_and_the_others_counted(tmp_path):
    with pytest.raises(InputError) as caught:
        read(tmp_path, "".join(f"key{i} = 1\n" for i in range(20)) + '[pet]\nkind = "cat"')
    assert len(caught.value.problem.splitlines()) == 1 + MOST_TOLD + 1
    assert caught.value.problem.endswith(f"and {20 - MOST_TOLD} more like these")


def test_files_of_windows_editors_are_read(tmp_path):
    """With a byte order mark in front, and carriage returns."""
    text = 'name = "Größe"  # in einem Kommentar: µ\n'
    (tmp_path / "plain.toml").write_bytes(text.encode())
    (tmp_path / "windows.toml").write_bytes(text.replace("\n", "\r\n").encode("utf-8-sig"))
    assert read_toml(tmp_path / "windows.toml") == read_toml(tmp_path / "plain.toml") == ({"name": "Größe"}, text)


def test_files_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_settings(tmp_path / "nowhere.toml", House)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not text in UTF-8"):
        read_settings(tmp_path / "binary.toml", House)
