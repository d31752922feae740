// Earth dam, 60 m wide at the base, crest 6 m, 15 m high; clay core; rock toe drain 6 m by 3 m downstream.
SetFactory("Built-in");
lc = 1.5;
Point(1) = {0, 0, 0, lc};
Point(2) = {24, 12, 0, lc};   // full reservoir level 12 m
Point(3) = {30, 15, 0, lc};
Point(4) = {36, 15, 0, lc};
Point(5) = {54, 3, 0, lc/3};  // top of the toe drain (slope 1:1.5)
Point(6) = {58.5, 0, 0, lc/3};
Point(7) = {50, 0, 0, lc/3};
Point(8) = {28, 0, 0, lc};
Point(9) = {38, 0, 0, lc};
Point(10) = {31.5, 14, 0, lc/2};
Point(11) = {34.5, 14, 0, lc/2};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5};
Line(5) = {5, 6}; Line(6) = {6, 7}; Line(7) = {7, 9}; Line(8) = {9, 8}; Line(9) = {8, 1};
Line(10) = {8, 10}; Line(11) = {10, 11}; Line(12) = {11, 9}; Line(13) = {7, 5};
Curve Loop(1) = {8, 10, 11, 12};          Plane Surface(1) = {1};  // core
Curve Loop(2) = {5, 6, 13};               Plane Surface(2) = {2};  // drain
Curve Loop(3) = {1, 2, 3, 4, -13, 7, -12, -11, -10, 9}; Plane Surface(3) = {3}; // shell
Physical Curve("water side") = {1};
Physical Curve("freeboard") = {2};
Physical Curve("crest") = {3};
Physical Curve("downstream face") = {4};
Physical Curve("drain outlet") = {5};
Physical Curve("base") = {6, 7, 8, 9};
Physical Surface("core") = {1};
Physical Surface("drain") = {2};
Physical Surface("shell") = {3};
