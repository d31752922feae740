"""Texts of `.geo` files: usual ones that Gmsh meshes and hostile ones that must touch nothing: they write hacked."""

SQUARE = """Point(1) = {0, 0, 0, 0.3}; Point(2) = {1, 0, 0, 0.3}; Point(3) = {1, 1, 0, 0.3}; Point(4) = {0, 1, 0, 0.3};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
"""
OCC = 'SetFactory("OpenCASCADE");\n'

USUAL = {
    "variables": "h = 0.3; n() = {1, 2, 3}; n() += {4}; k = #n();\n" + SQUARE + "Physical Surface(1) = {1};",
    "comments": '// é " \' SystemCall\n/* ü " // */' + SQUARE + 'Physical Curve("Außenrand Γ") = {1, 2}; // end',
    "loops": """For i In {0:3}
  p~{i} = newp; Point(p~{i}) = {Cos(i*Pi/2), Sin(i*Pi/2), 0, 0.4};
EndFor
For i In {0:3}
  l[i] = newl; Line(l[i]) = {p~{i}, p~{(i + 1) % 4}};
EndFor
Curve Loop(10) = {l[]}; Plane Surface(1) = {10}; Physical Surface("all") = {1};
For i In {0:3}
  Physical Curve(Sprintf("side%.0f", i)) = {l[i]};
EndFor""",
    "loops on two lines": SQUARE + 'For i In {1:4}\nPhysical Curve(Sprintf("s%g", i)) = {i}; EndFor',
    "conditions": "a = 1; If (a == 1 && !(a > 2)) h = 0.2; ElseIf (a == 2) h = 0.1; Else h = 0.5; EndIf\n" + SQUARE,
    "macros": SQUARE
    + """Macro Opening
  c = newp; Point(c) = {x, y, 0, 0.1}; a = newp; Point(a) = {x + r, y, 0, 0.1}; b = newp; Point(b) = {x - r, y, 0, 0.1};
  m = newl; Circle(m) = {a, c, b}; k = newl; Circle(k) = {b, c, a};
  loop = newll; Curve Loop(loop) = {m, k};
Return
Delete { Surface{1}; }
x = 0.3; y = 0.5; r = 0.1;
Call Opening;
holes() = {loop}; x = 0.7;
Call Opening;
holes() += {loop};
Plane Surface(1) = {1, holes()}; Physical Surface("plate") = {1};""",
    "constants": 'DefineConstant[ h = {0.3, Min 0.1, Max 1, Step 0.1, Name "Mesh size", Label "size"}, n = 3 ];\n'
    'DefineConstant[ order = {1, Choices{1="first", 2="second"}, Name "Order"} ];\n' + SQUARE,
    "options": "Mesh.Algorithm = 6; Mesh.CharacteristicLengthMax = 0.25; Mesh.MeshSizeFromCurvature = 12;\n"
    "Geometry.Tolerance = 1e-9; General.Terminal = 1; Mesh.MshFileVersion = 2.2;\n" + SQUARE,
    "printing": 'Printf("h = %g", 0.3); Printf("x");\n' + SQUARE + 'Printf("done", 1, 2);',
    "fields": SQUARE
    + """Field[1] = Distance; Field[1].CurvesList = {1}; Field[1].Sampling = 50;
Field[2] = Threshold; Field[2].InField = 1; Field[2].SizeMin = 0.1; Field[2].SizeMax = 0.4; Field[2].DistMin = 0.1;
Field[2].DistMax = 0.5;
Field[3] = Box; Field[3].VIn = 0.1; Field[3].VOut = 0.4; Field[3].XMin = 0; Field[3].XMax = 0.3; Field[3].YMin = 0;
Field[3].YMax = 0.3; Field[4] = Min; Field[4].FieldsList = {2, 3}; Background Field = 4;
Mesh.MeshSizeExtendFromBoundary = 0;""",
    "formulas": SQUARE + 'Field[1] = MathEval; Field[1].F = "0.1 + 0.2*x^2 + sin(y)/10"; Background Field = 1;',
    "formulas made": SQUARE
    + 's = 0.1; Field[1] = MathEval; Field[1].F = Sprintf("%g + 0.2*x", s); Background Field = 1;',
    "transfinite": SQUARE
    + "Transfinite Curve {1, 3} = 4 Using Progression 1.2; Transfinite Curve {2, 4} = 5 Using Bump 2;\n"
    "Transfinite Surface {1} Alternate;",
    "splines": """h = 0.2; Point(1) = {0, 0, 0, h}; Point(2) = {1, 0, 0, h}; Point(3) = {1.2, 0.7, 0, h};
Point(4) = {0.5, 1.2, 0, h}; Point(5) = {0, 0.8, 0, h}; Line(1) = {1, 2}; Spline(2) = {2, 3, 4}; BSpline(3) = {4, 5, 1};
Line Loop(1) = {1:3}; Plane Surface(1) = {1}; Physical Line("curved") = {2, 3}; Physical Surface("in", 7) = {1};""",
    "arcs": """Point(1) = {0, 0, 0, 0.2}; Point(2) = {2, 0, 0, 0.2}; Point(3) = {0, 1, 0, 0.2};
Point(4) = {1, 0, 0, 0.2}; Line(1) = {1, 2};
Ellipse(2) = {2, 1, 4, 3}; Line(3) = {3, 1}; Curve Loop(1) = {1, 2, 3}; Plane Surface(1) = {1};""",
    "copies": SQUARE
    + """b() = Translate {2, 0, 0} { Duplicata { Surface{1}; } };
Rotate {{0, 0, 1}, {0, 0, 0}, Pi/6} { Surface{b(0)}; } e() = Boundary { Surface{1}; }; Physical Curve("e") = {e()};
Physical Surface("both") = {1, b(0)}; Coherence;""",
    "extrusion": SQUARE + 'v() = Extrude {0, 0, 1} { Surface{1}; Layers{2}; };\nPhysical Volume("v") = {v(1)};\n'
    'Physical Surface("top") = {v(0)};',
    "revolution": SQUARE
    + "Translate {1, 0, 0} { Surface{1}; }\nv() = Extrude {{0, 1, 0}, {0, 0, 0}, Pi/2} { Surface{1}; };",
    "rectangles": OCC
    + """Rectangle(1) = {0, 0, 0, 2, 1}; Disk(2) = {1, 0.5, 0, 0.2}; Disk(3) = {0.4, 0.4, 0, 0.1};
BooleanDifference(4) = { Surface{1}; Delete; }{ Surface{2, 3}; Delete; };
b() = Boundary{ Surface{4}; }; Physical Curve("all", 1) = b(); MeshSize{ PointsOf{ Surface{4}; } } = 0.15;""",
    "fragments": OCC
    + """Rectangle(1) = {0, 0, 0, 1, 1}; Rectangle(2) = {1, 0, 0, 1, 1};
f() = BooleanFragments{ Surface{1}; Delete; }{ Surface{2}; Delete; };
bottom() = Curve In BoundingBox {-1e-3, -1e-3, -1e-3, 2.001, 1e-3, 1e-3}; Physical Curve("bottom") = bottom();
Physical Surface("left") = {f(0)}; Physical Surface("right") = {f(1)}; Mesh.MeshSizeMax = 0.3;""",
    "solids": OCC
    + """Box(1) = {0, 0, 0, 1, 1, 1}; Sphere(2) = {0.5, 0.5, 1, 0.3}; Cylinder(3) = {0.5, 0.5, -1, 0, 0, 3, 0.1};
BooleanUnion(4) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
BooleanDifference(5) = { Volume{4}; Delete; }{ Volume{3}; Delete; };
Physical Surface("boundary") = Abs(Boundary{ Volume{5}; }); Physical Volume("v") = {5}; Mesh.MeshSizeMax = 0.4;""",
    "fillets": OCC
    + """Box(1) = {0, 0, 0, 1, 1, 1}; Fillet{1}{1, 3}{0.1} Mesh.MeshSizeMax = 0.5; Mesh.MeshSizeMin = 0.2;""",
    "commands that are done anyway": SQUARE + "Mesh 2;",
    "embedded": SQUARE + "Point(9) = {0.5, 0.5, 0, 0.05}; Point{9} In Surface{1}; Characteristic Length {1, 2} = 0.1;",
    "volumes": 'SetFactory("Built-in");\n'
    + SQUARE
    + 'Extrude {0, 0, 1} { Surface{1}; } Surface Loop(99) = {1}; s() = Surface{:}; Physical Surface("all") = s();',
    "pieces of expressions": "x = 1.5e-3 + .5 - 2. * (3 > 2 ? 1 : 1e22); y = Hypot(3, 4) + Max(1, Atan2(1, 2));\n"
    "z = x^2 % 3; z += 1; z *= 2; z -= 1; z /= 3; z++; q = newreg;\n" + SQUARE,
}

CALL = ' "touch hacked";'
"""Text after the name of a command."""

HOSTILE = [
    "Curve Loop(1) = {2147483648:n};",
    "For i In {1:1e9} n = i; EndFor",
    "Point(1e308) = {0, 0, 0, 1};",  # Gmsh asks for all of the memory
    # commands, by their names and by names that are made
    *(
        f'{name} "{what}";'
        for name, what in {
            **{"SystemCall": "touch hacked", "System": "touch hacked", "NonBlockingSystemCall": "touch hacked"},
            **{"Include": "/etc/passwd", "Merge": "/etc/hostname", "MergeWithBoundingBox": "x.stp", "Open": "x.geo"},
            **{"Save": "hacked", "Print": "hacked.png", "CreateDir": "hacked", "SetName": "x", "SendToServer": "x"},
            **{"Warning": "x", "Error": "x", "Show": "*", "Hide": "*", "UnknownCommand": "touch hacked"},
        }.items()
    ),
    'StringToName["SystemCall"]' + CALL,
    'S2N["SystemCall"]' + CALL,
    'StringToName[StrCat["System", "Call"]]' + CALL,
    'x = "SystemCall"; S2N[x]' + CALL,
    'S2N["x"]~{1} = 2;',
    'éSystemCall "touch hacked";',
    'ASystemCall\u00a0"touch hacked";',
    'System\\\nCall "touch hacked";',
    '\ufeff\ufeffSystemCall "touch hacked";',
    "General.AbortOnError = 0;\ns = '" + "a" * 1000 + '"' + "b" * 22 + '; SystemCall "touch hacked";',
    's = "' + "a" * 1023 + 'SystemCall "touch hacked";',
    "s = 'x'; SystemCall 'touch hacked';",
    '\'"\' SystemCall "touch hacked";',
    'SystemCall // "\n"touch hacked";',
    'SystemCall /* */ "touch hacked";',
    '/* " */ SystemCall /* " */ "touch hacked";',
    '/* // */ SystemCall "touch hacked";',
    '// \0 SystemCall "touch hacked";',
    '// x\rSystemCall "touch hacked";\n/* never closed',
    'SystemCall Str("touch hacked");',
    'SystemCall StrCat("touch ", "hacked");',
    'SystemCall Sprintf("touch hacked%g", 1);',
    "SystemCall CurrentDirectory;",
    "Include CurrentFileName;",
    "Include GmshExecutableName;",
    'SystemCall GetEnv("HOME");',
    'SystemCall GetString("x", "touch hacked");',
    "SystemCall N2S[touch];",
    "SystemCall Today;",
    "SystemCall OnelabAction;",
    'x = "touch hacked"; SystemCall x;',
    'x = "touch hacked"; SystemCall x[0];',
    'OnelabRun("x", "touch hacked");',
    'OnelabRun "touch hacked";',
    # hidden where Gmsh skips text by other rules than those of its lexer
    'If (0) I/* EndIf SystemCall "touch hacked"; */ EndIf',
    'If (0)\nI"EndIf SystemCall " touch hacked ";\nEndIf',
    'Macro F I"Return SystemCall "touch hacked"; Return',
    'For i In {1:0} E\'EndFor SystemCall "touch hacked"; EndFor',
    'Physical Curve( EndIf SystemCall "touch hacked" ) = 1;',
    'If (0) Physical Curve("x", EndIf) = 1; EndIf',
    "x = {If (1)};",
    'Macro "F" SystemCall "touch hacked"; Return Call "F";',
    # long lines, on which loops jump
    "x = 1; " * 1200 + 'For i In {1:2} ySystemCall "touch hacked"; EndFor',
    "a" * 9000 + "SystemCall = 1;",
    "x = " + "9" * 5000 + ";",
    "x" * 101 + " = 1;",
    # files
    'General.LogFileName = "hacked";',
    'General.ErrorFileName = "hacked";',
    'General.OptionsFileName = "hacked";',
    'General.DefaultFileName = "hacked";',
    'General.GraphicsFontEngine = "x";',
    'General.ExecutableFileName = "hacked";',
    'General.WatchFilePattern = "*";',
    "General.AbortOnError = 0;",
    "General.SaveOptions = 1;",
    "General.SaveSession = 1;",
    'Solver.Executable0 = "touch hacked";',
    'Solver.SocketName = "hacked";',
    'Solver.RemoteLogin0 = "x";',
    "Solver.AutoMesh = 1;",
    "Solver.AlwaysListen = 1;",
    "Print.Background = 1;",
    'Print.ParameterCommand = "SystemCall";',
    'PostProcessing.GraphPointCommand = "SystemCall";',
    'PostProcessing.DoubleClickedGraphPointCommand = "x";',
    'Geometry.DoubleClickedPointCommand = "SystemCall";',
    'Geometry.OCCTargetUnit = "M";',
    'Geometry.PipeDefaultTrihedron = "x";',
    'Mesh.MeshSizeFile = "x";',
    'Mesh.Algorithm = "x";',
    "Mesh 2",
    'Mesh 2 "x";',
    "Mesh x;",
    'x.y = "touch hacked";',
    "x.y = 1;",
    'x[0].y = "touch hacked";',
    "General.Color.Background = Red;",
    "Mesh . ColorCarouselX = 1;",
    "Mesh::x.y = 1;",
    'Field[1] = Structured; Field[1].FileName = "/etc/passwd";',
    'Field[1] = Distance; Field[1].FileName = "/etc/passwd";',
    'Field[1] = ExternalProcess; Field[1].CommandLine = "touch hacked";',
    'Field[1].CommandLine = "touch hacked";',
    "Field[1] = PostView; Field[1].ViewIndex = 0;",
    "Field[1] = Octree;",
    "Field[1] = Unknown;",
    "Field[1] =",
    "Field[1].",
    "Field[x y].F = 1;",
    'Field[1].F = "x"; SystemCall "touch hacked";',
    'Field[1].F = "touch `hacked`";',
    'Field[1].F = Sprintf("%n%n%n%n", 1);',
    'Field[1].SizeMin = "x";',
    'Field["x"] = Box;',
    'Printf("x") > "hacked";',
    'Printf("x") >> "hacked";',
    'Printf("%g", 1) > Str("hacked");',
    'Printf ( ) x "hacked";',
    "Printf",
    'x = ListFromFile["/etc/passwd"];',
    'ShapeFromFile("x.step");',
    'v() = ShapeFromFile("/etc/passwd");',
    'x = FileExists("/etc/passwd");',
    'x = GetEnv("HOME");',
    'x = GetString("General.UserHome");',
    'x = GetNumber("General.x", 1);',
    'x = GetValue("q", 1);',
    'x = Str("a", "b");',
    'x = "a";',
    'x() = Str("a", "b");',
    'SetString("x", "y");',
    'SetNumber("General.AbortOnError", 0);',
    'x = StrFind("a", "b");',
    'x = TextAttributes("Font", "Courier");',
    'x = DefineString("touch hacked", Name "x");',
    'x = DefineNumber(1, Name "x");',
    'Struct S [ a "touch hacked" ];',
    # plug-ins, views, sessions, ends
    "Plugin(MathEval).Run;",
    'Plugin(NewView).Expression = "x";',
    "Plugin(Homology).Run;",
    'View "x" { SP(0, 0, 0){1}; };',
    'View "x" { T2(0, 0, 0){ "touch hacked" }; };',
    'Save View[0] "hacked";',
    "Alias View[0];",
    "Combine Views;",
    "Exit;",
    "Exit 0;",
    "Abort;",
    "Sleep 1;",
    "Draw;",
    "NewModel;",
    "SyncModel;",
    "RefineMesh;",
    "PartitionMesh 3;",
    "Remesh 2;",
    "Delete Options;",
    "Delete All;",
    "Delete View[0];",
    "Delete Model;",
    "UnsplitWindow;",
    "SetCurrentWindow 1;",
    "ClassifySurfaces {1, 1, 1};",
    "CreateGeometry;",
    "Homology {{1}, {2}};",
    'Levelset MathEval (1) = "x";',
    'Parametric Surface(1) = "x" "y" "z";',
    "x = Cpu; y = Memory;",
    "x = TestLevel;",
    # names that are more than names
    'SetFactory("touch hacked");',
    'SetFactory("OpenCASCADE" SystemCall);',
    "SetFactory",
    'Physical Curve("x\\", 1) = {1};',
    'Physical Curve("`touch hacked`") = {1};',
    'Physical Curve("a\nb") = {1};',
    'Physical Curve("%n") = {1};',
    'Physical Curve("\x1b[2J") = {1};',
    'Physical Curve("\ufffd") = {1};',
    'Physical Curve(Sprintf("%999999g", 1)) = {1};',
    'Physical Curve(Sprintf("%s%n", 1)) = {1};',
    'Physical Curve(Sprintf("%f", 1e300)) = {1};',
    'Physical Curve(Sprintf("' + "a" * 300 + '%g", 1)) = {1};',
    'Physical Curve(GetEnv("HOME")) = {1};',
    'Physical Curve("' + "n" * 200 + '") = {1};',
    'Physical Curve(Sprintf("' + "\U0001f600" * 60 + '%g", 1)) = {1};',
    'Physical "x" = {1};',
    'Physical Curve("x") "y" = {1};',
    'Point "x";',
    'DefineConstant[ x = "touch hacked" ];',
    'DefineConstant[ x = {1, GmshOption "ResetDatabase", Name "x"} ];',
    'DefineConstant[ x = {1, ServerAction "touch hacked"} ];',
    'DefineConstant[ x = {1, Macro "x"} ];',
    'DefineConstant[ x = {"touch hacked", Name "x"} ];',
    'DefineConstant[ x = {1, Name StrCat("x", GetEnv("HOME"))} ];',
    "DefineConstant{ x = 1 };",
    "UndefineConstant[ x ];",
    # what is not the language
    "x = `touch hacked`;",
    "$x = 1;",
    "x = 1 @ 2;",
    "x = (1;",
    "x = 1);",
    "x = {1];",
    "[[[[",
    "\x1b[2J",
    "x = 1 \\ 2;",
    "x = ١;",
    "ｘ = 1;",
    "x = 1 \u200b 2;",
]
