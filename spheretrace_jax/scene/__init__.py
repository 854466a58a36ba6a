"""What a scene is, how its picture is seen, and what that picture needs computed."""
