// A box
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 2, 1, 0.3};
Physical Surface("left") = {1}; Physical Surface("right") = {2}; Physical Surface("sides") = {3, 4};
Physical Surface("bottom") = {5}; Physical Surface("top") = {6}; Physical Volume("box") = {1};
Mesh.MeshSizeMin = 0.5; Mesh.MeshSizeMax = 0.5;
