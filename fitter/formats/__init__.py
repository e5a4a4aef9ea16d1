load = load_all = None  # replaced by the formats room
