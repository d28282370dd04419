"""Lead a newcomer from an empty folder to a rig.toml with which a shot alone can be measured."""
