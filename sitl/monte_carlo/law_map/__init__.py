"""The map of the law: at which delays, losses, speeds and numbers of vehicles the law keeps the
safety distance. Each cell of the map is determined by flying it.
"""
