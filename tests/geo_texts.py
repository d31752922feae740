"""Texts of `.geo` files: usual ones that Gmsh meshes and hostile ones that must touch nothing: they write hacked."""

SQUARE = """Point(1) = {0, 0, 0, 0.3}; Point(2) = {1, 0, 0, 0.3}; Point(3) = {1, 1, 0, 0.3}; Point(4) = {0, 1, 0, 0.3};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
"""
OCC = 'SetFactory("OpenCASCADE");\n'

USUAL = {
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
    "fields": SQUARE
    + """Field[1] = Distance; Field[1].CurvesList = {1}; Field[1].Sampling = 50;
Field[2] = Threshold; Field[2].InField = 1; Field[2].SizeMin = 0.1; Field[2].SizeMax = 0.4; Field[2].DistMin = 0.1;
Field[2].DistMax = 0.5;
Field[3] = Box; Field[3].VIn = 0.1; Field[3].VOut = 0.4; Field[3].XMin = 0; Field[3].XMax = 0.3; Field[3].YMin = 0;
Field[3].YMax = 0.3; Field[4] = Min; Field[4].FieldsList = {2, 3}; Background Field = 4;
Mesh.MeshSizeExtendFromBoundary = 0;""",
    "formulas made": SQUARE
    + 's = 0.1; Field[1] = MathEval; Field[1].F = Sprintf("%g + 0.2*x", s); Background Field = 1;',
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
    "volumes": 'SetFactory("Built-in");\n'
    + SQUARE
    + 'Extrude {0, 0, 1} { Surface{1}; } Surface Loop(99) = {1}; s() = Surface{:}; Physical Surface("all") = s();',
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
    "General.AbortOnError = 0;\ns = '" + "a" * 1000 + '"' + "b" * 22 + '; SystemCall "touch hacked";',
    's = "' + "a" * 1023 + 'SystemCall "touch hacked";',
    'OnelabRun("x", "touch hacked");',
    # hidden where Gmsh skips text by other rules than those of its lexer
    'Macro F I"Return SystemCall "touch hacked"; Return',
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
    'General.ExecutableFileName = "hacked";',
    "General.AbortOnError = 0;",
    "General.SaveOptions = 1;",
    "General.SaveSession = 1;",
    'Solver.Executable0 = "touch hacked";',
    'Solver.SocketName = "hacked";',
    "Solver.AlwaysListen = 1;",
    'Print.ParameterCommand = "SystemCall";',
    'Mesh.MeshSizeFile = "x";',
    'Field[1] = Structured; Field[1].FileName = "/etc/passwd";',
    'Field[1] = ExternalProcess; Field[1].CommandLine = "touch hacked";',
    "Field[1] = PostView; Field[1].ViewIndex = 0;",
    'Field[1].F = Sprintf("%n%n%n%n", 1);',
    'Printf("x") > "hacked";',
    'Printf("x") >> "hacked";',
    'x = ListFromFile["/etc/passwd"];',
    'ShapeFromFile("x.step");',
    'x = GetEnv("HOME");',
    'x = GetString("General.UserHome");',
    'SetString("x", "y");',
    'SetNumber("General.AbortOnError", 0);',
    # plug-ins, views, sessions, ends
    "Plugin(MathEval).Run;",
    'Plugin(NewView).Expression = "x";',
    'View "x" { T2(0, 0, 0){ "touch hacked" }; };',
    'Save View[0] "hacked";',
    "Exit;",
    "Abort;",
    "Sleep 1;",
    "RefineMesh;",
    "Delete Options;",
    "Delete All;",
    "ClassifySurfaces {1, 1, 1};",
    # names that are more than names
    'SetFactory("touch hacked");',
    'Physical Curve("a\nb") = {1};',
    'Physical Curve("%n") = {1};',
    'Physical Curve("\x1b[2J") = {1};',
    'Physical Curve(Sprintf("%999999g", 1)) = {1};',
    'Physical Curve(Sprintf("%f", 1e300)) = {1};',
    'Physical Curve(Sprintf("' + "a" * 300 + '%g", 1)) = {1};',
    'Physical Curve("' + "n" * 200 + '") = {1};',
    'Physical Curve(Sprintf("' + "\U0001f600" * 60 + '%g", 1)) = {1};',
    'DefineConstant[ x = {1, GmshOption "ResetDatabase", Name "x"} ];',
    # what is not the language
    "[[[[",
    "\x1b[2J",
    "x = 1 \\ 2;",
    "x = ١;",
]
