"""Checks `.geo` files: a file is split into tokens, and Gmsh gets a new text made of the allowed tokens only.

A `.geo` file is a program, and Gmsh would let it read and write files and start other programs. So Gmsh never gets the
file itself. It gets only tokens that are on a list (`geo_words`), one on each line, without comments. Strings are
allowed only as names of physical groups or parameters, as formulas of size fields, and as the name of the kernel;
everything that Gmsh does with files or programs needs a string in another place. Even where this lexer and Gmsh's read
the file differently, Gmsh gets only what was checked. (For example, Gmsh skips text by other rules than it parses.)
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.geo_words import (
    ALLOWED,
    FACTORIES,
    FIELD_FORMULAS,
    FIELD_OPTIONS,
    FIELDS,
    FLOW,
    OPTIONS,
    PARAMETER,
    REFUSED,
    TEXT,
)

LARGEST_FILE = 2**24
LARGEST = 1e30
"""Largest number. Gmsh's files use 1e22 for "any"; with 1e308 as the number of a point Gmsh would take all memory."""
LARGEST_IN_RANGE = 1e7
"""Largest number beside the colon of a list such as 1:9; Gmsh stores the whole list."""
LONGEST = {"word": 100, "number": 100, "string": 1000, "operator": 3}
"""Most characters of a token; Gmsh's buffer for a string holds 1023."""
LONGEST_NAME = 200
"""Most bytes of the name of a group, and of a format of Sprintf that makes one; Gmsh's buffer for it holds 255."""
INSTEAD = (
    "a .geo file may describe a geometry, its mesh sizes and its physical groups, and not run programs, use other "
    "files or end the program; mesh it with Gmsh and give the .msh file"
)
TOKEN = re.compile(
    r"""
    (?P<space>\s+|//[^\n]*|/\*.*?\*/)
    |(?P<number>[0-9]+\.[0-9]*(?:[eE][-+]?[0-9]+)?|[0-9]*\.[0-9]+(?:[eE][-+]?[0-9]+)?|[0-9]+(?:[eE][-+]?[0-9]+)?)
    |(?P<word>[A-Za-z_][A-Za-z_0-9]*)
    |(?P<string>"[^"\n]*")
    |(?P<operator>\.\.\.|\|\||&&|\+\+|--|==|!=|<=|>=|\+=|-=|\*=|/=|[]()[{},;=+*/%^!<>?:&|\#~.-])
    """,
    re.VERBOSE | re.DOTALL,
)
CLOSING = {"(": ")", "[": "]", "{": "}"}
AFTER_VARIABLE = frozenset(("In", "Using", "Plane"))
"""Words that may follow a variable; any other word, number or string there would make the variable a command."""
NAME = re.compile(r'[^"\\`%$\ufffd]*')
FORMAT = re.compile(r'(?:[^"\\`%$\ufffd]|%(?:\.[0-9])?g|%\.0f)*')
"""Formats of Sprintf. Gmsh passes them to C's sprintf with a short buffer, for which %f can be too long."""
FORMULA = re.compile(r"(?:[A-Za-z_0-9 ,.()+*/^<>=!&|-]|%(?:\.[0-9])?g)*")


@dataclass(frozen=True)
class Token:
    """A piece of the text.

    Attributes:
        kind: "number", "word", "string" or "operator".
        text: Its text; a string has its quotes.
        line: Number of its line, from 1.
    """

    kind: str
    text: str
    line: int


@dataclass
class _Statements:
    """The tokens, and for each bracket where it closes."""

    tokens: list[Token]
    closing: dict[int, int] = field(default_factory=dict)

    def text(self, index: int) -> str:
        return self.tokens[index].text if 0 <= index < len(self.tokens) else ""

    def kind(self, index: int) -> str:
        return self.tokens[index].kind if 0 <= index < len(self.tokens) else ""

    def number(self, index: int) -> float:
        return float(self.text(index)) if self.kind(index) == "number" else 0.0


def allowed_tokens(content: bytes) -> list[Token]:
    """Split a `.geo` file into tokens and check them.

    Args:
        content: Contents of the file.

    Returns:
        The tokens for Gmsh, without commands that only print, and without `Mesh 2;`, because the mesh is made anyway.

    Raises:
        InputError: If the file contains anything that is not allowed.
    """
    if len(content) > LARGEST_FILE:
        raise InputError(f"has more than {LARGEST_FILE >> 20} MB; mesh it with Gmsh and give the .msh file")
    text = content.decode("utf-8-sig", errors="replace")  # other encodings occur in comments only
    if "\0" in text:
        raise InputError("is not a text file")
    statements = _Statements(list(_tokens(text)))
    _match_brackets(statements)
    return _checked(statements)


def text_for_gmsh(tokens: list[Token]) -> str:
    """The text for Gmsh: one token on each line, so that the number of a line is that of a token."""
    return "".join(token.text.replace("%.0f", "%.15g") + "\n" for token in tokens)


def with_lines_of(tokens: list[Token], message: str) -> str:
    """Replace line numbers in a message of Gmsh by those of the user's file."""

    def line(found: re.Match[str]) -> str:
        return f"line {tokens[max(min(int(found[1]), len(tokens)), 1) - 1].line}" if tokens else "line 1"

    return re.sub(r"line ([0-9]{1,9})", line, message)


def _tokens(text: str) -> Iterator[Token]:
    place, line = 0, 1
    while place < len(text):
        found = TOKEN.match(text, place)
        if found is None:
            raise InputError(f"line {line}: {_stray(text[place])}")
        kind, piece = str(found.lastgroup), found[0]
        if kind != "space":
            if text.startswith("/*", place):
                raise InputError(f"line {line}: the comment that begins here never closes")
            if len(piece) > LONGEST[kind]:
                raise InputError(
                    f"line {line}: '{_shown(piece[:20])}…' is a {kind} of more than {LONGEST[kind]} characters"
                )
            if kind == "number" and not float(piece) <= LARGEST:
                raise InputError(
                    f"line {line}: the number {_shown(piece)} is too large; numbers are at most {LARGEST:g}"
                )
            yield Token(kind, piece, line)
        line += piece.count("\n")
        place = found.end()


def _shown(text: str) -> str:
    """A piece of the file, safe to print on a terminal."""
    return ascii(text[:40])[1:-1] + "…" * (len(text) > 40)


def _stray(character: str) -> str:
    if character == '"':
        return "the string that begins here does not close on its line"
    if character == "'":
        return "names need double quotes, not single ones"
    return f"the character {character!a} is not allowed outside comments and names"


def _match_brackets(statements: _Statements) -> None:
    """Find where brackets close; the words to which Gmsh skips must be outside all brackets."""
    opened: list[int] = []
    for index, token in enumerate(statements.tokens):
        if token.kind == "operator" and token.text in CLOSING:
            opened.append(index)
        elif token.kind == "operator" and token.text in CLOSING.values():
            if not opened or CLOSING[statements.text(opened[-1])] != token.text:
                raise InputError(f"line {token.line}: '{token.text}' has no opening bracket")
            statements.closing[opened.pop()] = index
        elif token.kind == "word" and token.text in FLOW and opened:
            raise InputError(f"line {token.line}: '{token.text}' is inside brackets, but it begins a statement")
    if opened:
        token = statements.tokens[opened[-1]]
        raise InputError(f"line {token.line}: '{token.text}' is never closed")


def _checked(statements: _Statements) -> list[Token]:
    """Check token by token; a handler checks what begins with its word and returns where that ends."""
    special = {"Printf": _printf, "SetFactory": _factory, "Physical": _physical, "Field": _field}
    special |= {"DefineConstant": _parameters} | dict.fromkeys(OPTIONS, _option)
    result: list[Token] = []
    index = 0
    while index < len(statements.tokens):
        token = statements.tokens[index]
        handler = special.get(token.text) if token.kind == "word" else None
        end = handler(statements, index) if handler is not None else _plain(statements, index)
        if not (token.text == "Printf" or _is_meshing(statements, index)):
            result += statements.tokens[index:end]
        index = end
    return result


def _is_meshing(statements: _Statements, index: int) -> bool:
    """Whether this is `Mesh 2;`, which is not needed, because the mesh is made anyway."""
    return [statements.text(index), statements.text(index + 2)] == ["Mesh", ";"] and statements.kind(
        index + 1
    ) == "number"


def _refuse(token: Token, why: str = INSTEAD) -> InputError:
    return InputError(f"line {token.line}: '{token.text}' is not allowed: {why}")


def _plain(statements: _Statements, index: int) -> int:
    """A token that begins nothing special: not a string, not a member such as a.b, not a command."""
    token = statements.tokens[index]
    if token.kind == "string":
        raise InputError(
            f"line {token.line}: the string {_shown(token.text)} is not allowed here: strings are names of physical "
            "groups and parameters, or formulas of fields"
        )
    if token.text == ".":
        raise InputError(
            f"line {token.line}: '{statements.text(index - 1)}.{statements.text(index + 1)}' is not allowed: the only "
            "options are those of Mesh and Geometry that are numbers"
        )
    if (
        token.text == ":"
        and max(map(statements.number, (index - 1, index + 1))) > LARGEST_IN_RANGE
        and "?" not in map(statements.text, range(index - 9, index))  # after which the colon belongs to a ? b : c
    ):
        raise InputError(f"line {token.line}: numbers beside ':' are at most {LARGEST_IN_RANGE:g}")
    if token.kind == "word":
        _check_word(statements, index)
    return index + 1


def _check_word(statements: _Statements, index: int) -> None:
    token = statements.tokens[index]
    if token.text in REFUSED or token.text in TEXT:
        raise _refuse(token)
    if token.text in ALLOWED or statements.text(index - 1) in ("Macro", "Function"):
        return
    if statements.text(index - 1) == "Delete":
        raise _refuse(token, "delete { shapes }")
    follower = statements.kind(index + 1)
    if follower in ("number", "string") or (follower == "word" and statements.text(index + 1) not in AFTER_VARIABLE):
        raise _refuse(token, "it is not a command that describes a geometry; " + INSTEAD)


def _printf(statements: _Statements, index: int) -> int:
    """Leave out what is printed on the terminal, and refuse to print into files."""
    if statements.text(index + 1) != "(":
        raise _refuse(statements.tokens[index])
    end = statements.closing[index + 1] + 1
    if statements.text(end) != ";":
        raise InputError(f"line {statements.tokens[index].line}: 'Printf to a file' is not allowed: {INSTEAD}")
    return end + 1


def _factory(statements: _Statements, index: int) -> int:
    name = statements.text(index + 2)
    if statements.text(index + 1) != "(" or statements.text(index + 3) != ")" or name.strip('"') not in FACTORIES:
        raise InputError(f'line {statements.tokens[index].line}: SetFactory takes "OpenCASCADE" or "Built-in"')
    return index + 4


def _physical(statements: _Statements, index: int) -> int:
    """`Physical Curve("name") = …`, or a group in a list, where it has no name."""
    opening = index + 2
    if statements.text(opening) != "(":
        return index + 1
    end = statements.closing[opening]
    for inside in range(index + 1, end):
        _check_text(statements, inside, NAME, "a name of a physical group")
    return end + 1


def _check_text(statements: _Statements, index: int, pattern: re.Pattern[str], what: str) -> None:
    """Check a token in a place where a string is allowed."""
    token = statements.tokens[index]
    if token.kind == "string":
        formatted = statements.text(index - 2) == "Sprintf"
        if (formatted or pattern is NAME) and len(token.text.encode()) > LONGEST_NAME:
            raise InputError(f"line {token.line}: {_shown(token.text[:20])}… has more than {LONGEST_NAME} bytes")
        pattern = FORMAT if formatted and pattern is NAME else pattern
        if not pattern.fullmatch(token.text[1:-1]) or not token.text.isprintable():
            raise InputError(
                f"line {token.line}: {_shown(token.text)} is not allowed as {what}: it has a character with a special "
                "meaning"
            )
    elif token.text not in TEXT:
        _plain(statements, index)


def _field(statements: _Statements, index: int) -> int:
    """`Field[1] = Kind;`, `Field[1].Option = …;`, or the word in `Background Field = 1;`."""
    if statements.text(index + 1) != "[":
        return index + 1
    after = statements.closing[index + 1] + 1
    for inside in range(index + 2, after - 1):
        _plain(statements, inside)
    if statements.text(after) == "=":
        kind = statements.tokens[min(after + 1, len(statements.tokens) - 1)]
        if kind.text not in FIELDS:
            raise _refuse(kind, "a field is one of " + ", ".join(sorted(FIELDS)))
        return after + 2
    if statements.text(after) != ".":
        return after
    option = statements.tokens[min(after + 1, len(statements.tokens) - 1)]
    if option.text not in FIELD_OPTIONS:
        raise _refuse(option, "it is not an option of a field that is computed from the geometry")
    end = after + 2
    while option.text in FIELD_FORMULAS and end < len(statements.tokens) and statements.text(end) != ";":
        _check_text(statements, end, FORMULA, "a formula")
        end += 1
    return end


def _option(statements: _Statements, index: int) -> int:
    """`Mesh.Algorithm`, which may be set or read."""
    token, name = statements.tokens[index], statements.text(index + 2)
    if _is_meshing(statements, index):
        return index + 3
    if statements.text(index + 1) != ".":
        raise _refuse(token)
    if name not in OPTIONS[token.text]:
        raise InputError(
            f"line {token.line}: '{token.text}.{name}' is not allowed: it is not an option that changes the mesh"
        )
    return index + 3


def _parameters(statements: _Statements, index: int) -> int:
    """`DefineConstant[ h = {0.1, Min 0, Max 1, Name "mesh size"} ];`."""
    if statements.text(index + 1) != "[":
        raise _refuse(statements.tokens[index], "it is written DefineConstant[ name = value ]")
    end = statements.closing[index + 1]
    for inside in range(index + 2, end):
        token = statements.tokens[inside]
        if token.text in PARAMETER and statements.text(inside - 1) in (",", "{"):
            continue
        if token.kind == "string" and not (statements.text(inside - 1) in PARAMETER or _is_choice(statements, inside)):
            raise InputError(
                f"line {token.line}: the string {_shown(token.text)} is not allowed here: parameters are "
                "numbers; strings name them after Name, Label, Help or Units"
            )
        _check_text(statements, inside, NAME, "a name of a parameter")
    return end + 1


def _is_choice(statements: _Statements, index: int) -> bool:
    """Whether a string is the label of one of several values, `Choices{0="coarse", 1="fine"}`."""
    while index > 0 and statements.text(index) not in ("{", "[", ";"):
        index -= 1
    return statements.text(index) == "{" and statements.text(index - 1) == "Choices"
