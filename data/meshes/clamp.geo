// A strap clamp, 100 mm long: a screw presses on its back, its rounded toe holds the work, its heel stands on the table
// and leans on a stop.
// Lengths in mm.
h = 2.5;
f = 0.4; // at the toe and the heel
Point(1) = {0, 0.2, 0, f};
Point(2) = {16, 0.2, 0, f};
Point(3) = {8, 160.1, 0, f}; // the middle of the toe's arc, which touches y = 0
Point(4) = {16, 10, 0, h};
Point(5) = {84, 10, 0, h};
Point(6) = {84, 0, 0, f};
Point(7) = {100, 0, 0, f};
Point(8) = {100, 24, 0, h};
Point(9) = {60, 24, 0, h};
Point(10) = {44, 24, 0, h};
Point(11) = {0, 24, 0, h};
Circle(1) = {1, 3, 2};
Line(2) = {2, 4};
Line(3) = {4, 5};
Line(4) = {5, 6};
Line(5) = {6, 7};
Line(6) = {7, 8};
Line(7) = {8, 9};
Line(8) = {9, 10};
Line(9) = {10, 11};
Line(10) = {11, 1};
Curve Loop(1) = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10};
Plane Surface(1) = {1};
Physical Surface("steel") = {1};
Physical Curve("toe") = {1};
Physical Curve("heel") = {5};
Physical Curve("washer") = {8};
Physical Curve("stop") = {6};
Physical Curve("free") = {2, 3, 4, 7, 9, 10};
