// Two blocks that meet along y = 0, with small cells around the origin. Mesh with Gmsh: gmsh -2 pressed_blocks.geo
far = 2; near = 0.05; a = 0.8;
Point(1) = {-8, -8, 0, far}; Point(2) = {8, -8, 0, far}; Point(3) = {8, 0, 0, far};
Point(4) = {8, 8, 0, far};   Point(5) = {-8, 8, 0, far}; Point(6) = {-8, 0, 0, far};
Point(7) = {-a, 0, 0, near}; Point(8) = {a, 0, 0, near};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 6}; Line(6) = {6, 1};
Line(7) = {6, 7}; Line(8) = {7, 8}; Line(9) = {8, 3};
Curve Loop(1) = {1, 2, -9, -8, -7, 6}; Plane Surface(1) = {1};
Curve Loop(2) = {7, 8, 9, 3, 4, 5};    Plane Surface(2) = {2};
Physical Curve("bottom") = {1}; Physical Curve("right") = {2, 3};
Physical Curve("top") = {4};    Physical Curve("left") = {5, 6};
Physical Curve("contact") = {7, 8, 9};
Physical Surface("lower") = {1}; Physical Surface("upper") = {2};
