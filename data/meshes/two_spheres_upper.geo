// A quarter of the lower half of a ball of radius 50 whose lowest point is the origin; `face` is its cap up to r = 16
near = 2.6; far = 16; r = 16; z = 50 - Sqrt(50^2 - r^2);
Point(1) = {0, 0, 50, far}; Point(2) = {0, 0, 0, near};
Point(3) = {r, 0, z, near}; Point(4) = {0, r, z, near}; Point(5) = {0, 0, z, near};
Point(6) = {50, 0, 50, far}; Point(7) = {0, 50, 50, far};
Circle(1) = {2, 1, 3}; Circle(2) = {3, 5, 4}; Circle(3) = {4, 1, 2};
Circle(4) = {3, 1, 6}; Circle(5) = {6, 1, 7}; Circle(6) = {7, 1, 4};
Line(7) = {2, 1}; Line(8) = {1, 6}; Line(9) = {7, 1};
Curve Loop(1) = {1, 2, 3}; Surface(1) = {1} In Sphere {1};
Curve Loop(2) = {4, 5, 6, -2}; Surface(2) = {2} In Sphere {1};
Curve Loop(3) = {7, 8, -4, -1}; Plane Surface(3) = {3};
Curve Loop(4) = {7, -9, 6, 3}; Plane Surface(4) = {4};
Curve Loop(5) = {8, 5, 9}; Plane Surface(5) = {5};
Surface Loop(1) = {1, 2, 3, 4, 5}; Volume(1) = {1};
Physical Surface("face") = {1}; Physical Surface("rest") = {2};
Physical Surface("along y") = {3}; Physical Surface("along x") = {4}; Physical Surface("middle") = {5};
Physical Volume("upper") = {1};
