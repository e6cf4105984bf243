"""Drawing in the 3D views: colours over objects, numbered landmarks."""
