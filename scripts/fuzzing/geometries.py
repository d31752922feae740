"""Broken and hostile `.geo` files."""

import random
import re
from pathlib import Path

from fuzzing import CASE, OUTPUT, Broken, Damage, Valid, damaged, mixed, renumbered, reworded
from signorini_fenicsx.base.shipped import data_folder

SQUARE = """h = 0.5;
Point(1) = {0, 0, 0, h}; Point(2) = {1, 0, 0, h}; Point(3) = {1, 1, 0, h}; Point(4) = {0, 1, 0, h};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
Physical Curve("bottom") = {1}; Physical Curve("others") = {2, 3, 4}; Physical Surface("inside") = {1};
"""
LOOPED = """n = 8; r = 1;
For i In {0:n-1}
  Point(i + 1) = {r*Cos(2*Pi*i/n), r*Sin(2*Pi*i/n), 0, 0.5};
EndFor
For i In {1:n} Line(i) = {i, (i < n) ? i + 1 : 1}; EndFor
Curve Loop(1) = {1:n}; Plane Surface(1) = {1};
Physical Curve("bottom") = {1, 2}; Physical Curve("others") = {3:n}; Physical Surface("inside") = {1};
"""
SOLID = """SetFactory("OpenCASCADE"); Rectangle(1) = {0, 0, 0, 1, 1}; Disk(2) = {0.5, 0.5, 0, 0.2};
BooleanDifference{ Surface{1}; Delete; }{ Surface{2}; Delete; }
Physical Curve("bottom") = {1}; Physical Curve("others") = {2:5}; Physical Surface("inside") = {1};
"""
LONG = "A" * 1023
CALL = 'SystemCall "touch hacked";'
HOSTILE = (
    CALL,
    'NonBlockingSystemCall "touch hacked";',
    'System "touch hacked";',
    'StringToName["SystemCall"] "touch hacked";',
    'S2N["SystemCall"] "touch hacked";',
    "éSystemCall 'touch hacked';",
    'General.AbortOnError = 0;\ns = "' + LONG + "\n" + CALL,
    "General.AbortOnError=0; s = '" + "a" * 1000 + '"' + "b" * 22 + CALL,
    "General.AbortOnError=0; s = '" + "a" * 999 + '"' + "b" * 23 + CALL,
    'x = "' + LONG + CALL + '";',
    '/* " */ SystemCall /* " */ "touch hacked";',
    "// \0 " + CALL,
    "System\\\nCall 'touch hacked';",
    'General.LogFileName = "hacked.log";',
    'General.LogFileName = "../home/hacked.log"; Point(99) = {0, 0, 0};',
    'General.OptionsFileName = "hacked"; General.SaveOptions = 1;',
    'General.GraphicsFontEngine = "hacked"; General.ExecutableFileName = "hacked";',
    'Solver.Executable0 = "touch hacked"; Solver.AutoCheck = 1; OnelabRun("x", "touch hacked");',
    'OnelabRun("x", "touch hacked");',
    'Field[1] = Structured; Field[1].FileName = "../home/.profile"; Background Field = 1;',
    'Field[1] = PostView; Field[1].FileName = "../home/.profile"; Background Field = 1;',
    "Field[1] = ExternalProcess; Field[1].CommandLine = 'touch hacked'; Background Field = 1;",
    'Merge "../home/.profile";',
    'Merge "other.geo";',
    'Include "other.geo";',
    'ShapeFromFile("../home/x.brep");',
    'a() = ListFromFile("../home/.profile");',
    'x = GetEnv("HOME"); Printf(x);',
    'Save "hacked.msh";',
    'Print "hacked.png";',
    'Print.Background = 1; Mesh 2; Save "hacked.msh";',
    'Printf("x") > "hacked";',
    'Printf("x") >> "hacked";',
    'Printf(Str("x", "y")) >"hacked";',
    'CreateDir "hacked";',
    'Plugin(CutPlane).Run; Plugin(NewView).Run; Save View [0] "hacked.pos";',
    'View "x" { SP(0, 0, 0){1}; }; Save View [0] "hacked.pos";',
    "Abort;",
    "Sleep 1;",
    'SetString("General.LogFileName", "hacked");',
    'DefineString[ s = {"", Name "a", Kind "file", ServerAction "touch hacked"} ];',
    'General.DefaultFileName = "hacked"; General.TmpFileName = "hacked"; General.ErrorFileName = "hacked";',
    'General.RecentFile0 = "hacked"; General.SessionFileName = "hacked"; General.SaveSession = 1;',
)  # fmt: skip
"""Text that runs programs, uses other files, or ends the program: it must touch nothing."""
ODD = (
    "// \\\n" + CALL,
    "// \r" + CALL,
    "// \x0b" + CALL,
    "//\x85" + CALL,
    "//\u2028" + CALL,
    "/* unclosed " + CALL,
    "#include 'other.geo'",
    'Field[1] = MathEval; Field[1].F = "system(1)"; Background Field = 1;',
    'x = GetString("name", "touch"); y = GetNumber("n", 3);',
    'Printf("%s%n%n%n%n");',
    'View "x" { SP(0, 0, 0){1}; }; View[0].FileName = "hacked"; View[0].AutoSave = 1;',
    "PostProcessing.Plugins = 1; Delete Physicals; Exit;",
    'Error("x"); Warning("y");',
    'SetNumber("General.AbortOnError", 3); SetChanged;',
    'DefineConstant[ x = {1, Name "a", Macro "GmshExit", File "../home/x"} ];',
    'Macro SystemCall\nPrintf("x");\nReturn\nCall SystemCall;',
    's = Str("SystemCall"); Call s;',
    'Macro Name("x") Return Call Str("System", "Call");',
    "Geometry.OCCAutoFix = 1; Mesh.Algorithm = 99; Mesh.MeshSizeFactor = -1; Mesh 7;",
    "Mesh.MeshSizeMin = 1e-300; Mesh.MeshSizeMax = 1e-300; RefineMesh; RefineMesh;",
    "General.NumThreads = 100000; Mesh.MaxNumThreads2D = 100000;",
    'Mesh.Renumber = 0; Mesh.Format = 10; Mesh.Binary = 1; Combine Mesh; CombineViews;',
    "Parametric Surface(9) = \"Exp(u)\" \"system('touch hacked')\" \"v\" ;",
    "x() = {1:200000}; y() = x() + x();",
    "Include 'a.geo' // " + "x" * 5000,
    "If (1) " * 300 + "EndIf " * 300,
    "x = " + "(" * 20_000 + "1" + ")" * 20_000 + ";",
    "Point(2147483648) = {0, 0, 0}; Point(-5) = {1e400, 0, 0}; Line(7) = {1, 99999};",
    "Physical Curve('" + "n" * 2000 + "') = {1}; Physical Curve(1e10) = {1};",
    "Periodic Curve {1} = {3}; Transfinite Curve {1} = 1e9;",
    "Extrude {0, 0, 1} { Surface{1}; Layers{500}; }",
)  # fmt: skip
"""Text that no geometry needs."""
TOKENS = (
    *"(){}[]=;,:?+-*/%^<>!&|~#.'\"", "==", "!=", "<=", "&&", "||", "+=", "++", "...", "Point", "Line", "Curve", "Loop",
    *("Surface", "Volume", "Physical", "Plane", "Circle", "Spline", "Extrude", "Rotate", "Translate", "Delete", "For"),
    *("EndFor", "If", "Else", "EndIf", "In", "Macro", "Return", "Call", "Field", "Transfinite", "Recombine", "Mesh"),
    *("newp", "Pi", "Sin", "Exp", "Sqrt", "Printf", "Str", "Sprintf", "StrCat", "DefineConstant", "Coherence"),
    *("h", "x", "1", "2", "3", "4", "0.5", "1e9", "-1", "{1,2,3}", '"bottom"', "//", "/*", "*/", "\n", "SetFactory"),
)  # fmt: skip
DAMAGES: tuple[Damage, ...] = (renumbered, renumbered, renumbered, reworded, reworded, mixed, mixed)


def geometry(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A geometry with a hostile line, extra tokens, or damage."""
    dam = (data_folder("meshes") / "dam.geo").read_text(encoding="utf-8")
    text, part = rng.choice(
        [(SQUARE, "bottom"), (SQUARE, "bottom"), (LOOPED, "bottom"), (SOLID, "bottom"), (dam, "face")]
    )
    way = rng.choice([_hostile, _hostile, _odd, _tokens, _damaged])
    data, about = way(rng, text)
    data = data.replace(b"hacked", str(folder / "hacked").encode())  # Gmsh has its own working folder
    (folder / "mesh.geo").write_bytes(data)
    (folder / "other.geo").write_text(CALL, encoding="utf-8")
    (folder / "mesh.geo.opt").write_text(CALL, encoding="utf-8")
    (folder / "case.toml").write_text(CASE.format(file="mesh.geo", part=part), encoding="utf-8")
    words = ["check", "case.toml"]
    if rng.random() < 0.2:
        words = ["info", "case.toml"]
    elif rng.random() < 0.15:
        words = ["solve", "case.toml", "--set", "solve.h=0.8", "--output", OUTPUT]
    return Broken(words, about, earlier=words[0] == "solve" and rng.random() < 0.5)


def _hostile(rng: random.Random, text: str) -> tuple[bytes, str]:
    """A hostile piece at the beginning, between two commands, or at the end."""
    return _with_piece(rng, text, rng.choice(HOSTILE))


def _odd(rng: random.Random, text: str) -> tuple[bytes, str]:
    """A piece that may be harmless, in the same places."""
    return _with_piece(rng, text, rng.choice(ODD))


def _with_piece(rng: random.Random, text: str, piece: str) -> tuple[bytes, str]:
    ends = [0, len(text), *(match.end() for match in re.finditer(r";\s*?\n", text))]
    at = rng.choice(ends)
    data = (text[:at] + "\n" + piece + "\n" + text[at:]).encode()
    if rng.random() < 0.1:
        data = rng.choice([b"\xef\xbb\xbf" + data, data.replace(b"\n", b"\r\n"), data.rstrip()])
    return data, repr(piece[:60])


def _tokens(rng: random.Random, text: str) -> tuple[bytes, str]:
    """Words of the language in wrong places."""
    parts = re.split(r"(?<=[ ;{},=])", text)
    for _ in range(rng.choice([1, 1, 2, 5])):
        parts.insert(rng.randrange(len(parts) + 1), " ".join(rng.choices(TOKENS, k=rng.choice([1, 2, 6]))))
    return "".join(parts).encode(), "tokens"


def _damaged(rng: random.Random, text: str) -> tuple[bytes, str]:
    return damaged(rng, text.encode(), DAMAGES if rng.random() < 0.7 else (renumbered,))
