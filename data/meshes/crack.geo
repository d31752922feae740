// A crack of length 2 in the middle of a square of 40, at 20 degrees to the x axis. Mesh with Gmsh: gmsh -2 crack.geo
a = 20*Pi/180; far = 4; near = 0.05;
Point(1) = {-20, -20, 0, far}; Point(2) = {20, -20, 0, far}; Point(3) = {20, 20, 0, far}; Point(4) = {-20, 20, 0, far};
Point(5) = {-Cos(a), -Sin(a), 0, near}; Point(6) = {Cos(a), Sin(a), 0, near};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1}; Line(5) = {5, 6};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
Curve{5} In Surface{1};
Physical Curve("bottom") = {1}; Physical Curve("right") = {2}; Physical Curve("top") = {3}; Physical Curve("left") = {4};
Physical Curve("crack") = {5};
Physical Surface("rock") = {1};
