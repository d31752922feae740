"""`[boundary]`: the parts of the boundary with each kind of condition."""

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, model_validator

from signorini_fenicsx.cases.complaints import keys_of, told
from signorini_fenicsx.meshes.checks import key_of


class Section(BaseModel):
    """A section of a case file."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Description(Section):
    """A section that describes an object, which can be made of it."""

    @model_validator(mode="after")
    def _can_be_made(self) -> Self:
        with told():
            self.made()
        return self

    def made(self) -> Any:
        """The object.

        Raises:
            InputError: If its data are not what they have to be.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Named:
    """All parts that a case names.

    Attributes:
        named: Lists of them by the keys that have them.
        kinds: The keys of `[boundary]` for kinds of conditions.
    """

    named: Mapping[str, list[str]]
    kinds: Collection[str]

    def listed(self) -> list[str]:
        """All of them, each once: inner ones are in the list of their condition, too."""
        return [part for key, parts in self.named.items() for part in parts if key != "inner"]

    def refuse_repetition(self) -> None:
        """Refuse a part that is listed twice.

        Raises:
            ValueError: If there is one.
        """
        repeated = sorted(part for part, times in Counter(self.listed()).items() if times > 1)
        if repeated:
            places = dict.fromkeys(key for key, parts in self.named.items() if repeated[0] in parts and key != "inner")
            raise ValueError(f"'{repeated[0]}' is listed twice: in {' and in '.join([*places][:2])}")

    def check(self, known: list[str], where: str, inside: Collection[str] = ()) -> None:
        """Make sure that the named parts exist and, if parts of Γ_D are listed, that every part is named.

        Args:
            known: All parts of the boundary, and inner ones.
            where: Name of the domain.
            inside: Those of them that are inside the domain.

        Raises:
            ValueError: If not; the message names key and part.
        """
        for key, part in ((key, part) for key, parts in self.named.items() for part in parts if part not in known):
            raise ValueError(f"{key_of(key)}: unknown part '{part}' of {where}; its parts are {', '.join(known)}")
        for part in {*inside} ^ {*self.named.get("inner", [])}:
            about = "inside the domain, and needs a [[law]]" if part in inside else "not inside the domain"
            raise ValueError(f"[boundary] inner: part '{part}' of {where} is {about}")
        left = [part for part in known if part not in self.listed()]
        if "dirichlet" in self.named and left:
            *others, last = self.kinds
            free = ["; without a load it is in neumann"] * ("neumann" in self.kinds)
            raise ValueError(f"[boundary] '{left[0]}' is in none of {', '.join(others)} and {last}{''.join(free)}")


class PartLists(Section):
    """`[boundary]`: parts for each kind of condition; "dirichlet" may be left out, and then has all others.

    Across parts inside the domain, "inner", u may jump. "sides" tells the named side of an inner part: the region of
    cells there, or a direction that points to it.
    """

    inner: list[str] = []
    sides: dict[str, str | list[float]] = {}

    @property
    def named(self) -> dict[str, list[str]]:
        """The lists that are given, by their keys."""
        lists = {key: list(value) for key, value in self if value is not None and key != "sides"}
        return lists if self.inner else {key: parts for key, parts in lists.items() if key != "inner"}

    def with_lists(self, lists: dict[str, list[str]]) -> Named:
        """The parts of this section and those of others."""
        kinds = [key for key in keys_of(type(self)) if key not in ("inner", "sides", "impervious")]
        return Named(self.named | lists, kinds)

    @model_validator(mode="after")
    def _no_repetition(self) -> Self:
        self.with_lists({}).refuse_repetition()
        return self

    def condition_of(self, part: str) -> str:
        """The condition on a part, in a word."""
        return next((key for key, parts in self.named.items() if part in parts and key != "inner"), "dirichlet")

    def check_inner(self, with_law: Collection[str], own_mesh: bool, law: str) -> None:
        """Make sure that inner parts have laws and are listed once, and that sides are those of inner parts of a file.

        Args:
            with_law: The parts with a law.
            own_mesh: Whether the mesh is of files or bodies.
            law: What the law is, in words; empty if none is needed.

        Raises:
            ValueError: If not.
        """
        for part in self.inner:
            if self.inner.count(part) > 1:
                raise ValueError(f"[boundary] inner: '{part}' is listed twice")
            if law and part not in with_law:
                raise ValueError(f"[boundary] inner: '{part}' needs {law}")
        for part in self.sides:
            if part not in self.inner or not own_mesh:
                raise ValueError(f"[boundary] sides.{part}: '{part}' is not an inner part of a mesh file")
