// Two blocks that meet along y = 0, each the mirror image of the other. Mesh with Gmsh: gmsh -2 two_blocks.geo
n = 17;
Point(1) = {0, -1, 0}; Point(2) = {1, -1, 0}; Point(3) = {1, 0, 0};
Point(4) = {1, 1, 0};  Point(5) = {0, 1, 0};  Point(6) = {0, 0, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4};
Line(4) = {4, 5}; Line(5) = {5, 6}; Line(6) = {6, 1}; Line(7) = {6, 3};
Curve Loop(1) = {1, 2, -7, 6}; Plane Surface(1) = {1};
Curve Loop(2) = {7, 3, 4, 5};  Plane Surface(2) = {2};
Transfinite Curve {1, 2, 3, 4, 5, 6, 7} = n;
Transfinite Surface {1} = {1, 2, 3, 6} Left; Transfinite Surface {2} = {6, 3, 4, 5} Right;
Physical Curve("bottom") = {1}; Physical Curve("right") = {2, 3};
Physical Curve("top") = {4};    Physical Curve("left") = {5, 6};
Physical Curve("contact") = {7};
Physical Surface("lower") = {1}; Physical Surface("upper") = {2};
