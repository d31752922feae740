// Half of a block that something round presses from above, with small cells around the origin, where it touches.
// Mesh with Gmsh: gmsh -3 pressed_block.geo
L = 16; far = 8; near = 0.2; a = 1.2;
Point(1) = {0, 0, 0, near};  Point(2) = {-a, 0, 0, near}; Point(3) = {a, 0, 0, near}; Point(4) = {0, a, 0, near};
Point(5) = {-L, 0, 0, far};  Point(6) = {L, 0, 0, far};   Point(7) = {L, L, 0, far};  Point(8) = {-L, L, 0, far};
Point(9) = {-L, 0, -L, far}; Point(10) = {L, 0, -L, far}; Point(11) = {L, L, -L, far}; Point(12) = {-L, L, -L, far};
Line(1) = {2, 1}; Line(2) = {1, 3}; Circle(3) = {3, 1, 4}; Circle(4) = {4, 1, 2};
Line(5) = {5, 2}; Line(6) = {3, 6}; Line(7) = {6, 7}; Line(8) = {7, 8}; Line(9) = {8, 5};
Line(10) = {9, 10}; Line(11) = {10, 11}; Line(12) = {11, 12}; Line(13) = {12, 9};
Line(14) = {5, 9}; Line(15) = {6, 10}; Line(16) = {7, 11}; Line(17) = {8, 12};
Curve Loop(1) = {1, 2, 3, 4};               Plane Surface(1) = {1};
Curve Loop(2) = {5, -4, -3, 6, 7, 8, 9};    Plane Surface(2) = {2};
Curve Loop(3) = {5, 1, 2, 6, 15, -10, -14}; Plane Surface(3) = {3};
Curve Loop(4) = {7, 16, -11, -15};          Plane Surface(4) = {4};
Curve Loop(5) = {8, 17, -12, -16};          Plane Surface(5) = {5};
Curve Loop(6) = {9, 14, -13, -17};          Plane Surface(6) = {6};
Curve Loop(7) = {10, 11, 12, 13};           Plane Surface(7) = {7};
Surface Loop(1) = {1, 2, 3, 4, 5, 6, 7};    Volume(1) = {1};
Physical Surface("contact") = {1}; Physical Surface("free") = {2, 4, 5, 6};
Physical Surface("symmetry") = {3}; Physical Surface("bottom") = {7};
Physical Volume("block") = {1};
