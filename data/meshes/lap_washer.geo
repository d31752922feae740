// A box
SetFactory("OpenCASCADE");
Box(1) = {1.25, 0.25, 0.6, 0.5, 0.5, 0.2};
Physical Surface("left") = {1}; Physical Surface("right") = {2}; Physical Surface("sides") = {3, 4};
Physical Surface("bottom") = {5}; Physical Surface("top") = {6}; Physical Volume("box") = {1};
Mesh.MeshSizeMin = 0.3; Mesh.MeshSizeMax = 0.3;
