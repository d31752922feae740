// Two bodies that meet along y = 0, finer in the middle. Mesh with Gmsh: gmsh -2 two_halves.geo
far = 1.5; near = 0.05;
Point(1) = {-6, -6, 0, far}; Point(2) = {6, -6, 0, far}; Point(3) = {6, 6, 0, far}; Point(4) = {-6, 6, 0, far};
Point(5) = {-6, 0, 0, far};  Point(6) = {-1, 0, 0, near}; Point(7) = {1, 0, 0, near}; Point(8) = {6, 0, 0, far};
Line(1) = {1, 2}; Line(2) = {2, 8}; Line(3) = {8, 3}; Line(4) = {3, 4}; Line(5) = {4, 5}; Line(6) = {5, 1};
Line(7) = {5, 6}; Line(8) = {6, 7}; Line(9) = {7, 8};
Curve Loop(1) = {1, 2, -9, -8, -7, 6}; Plane Surface(1) = {1};
Curve Loop(2) = {7, 8, 9, 3, 4, 5};    Plane Surface(2) = {2};
Physical Curve("bottom") = {1}; Physical Curve("right") = {2, 3}; Physical Curve("top") = {4}; Physical Curve("left") = {5, 6};
Physical Curve("contact") = {7, 8, 9};
Physical Surface("lower") = {1}; Physical Surface("upper") = {2};
