"""The world, the game and the referee: who leads this swarm?"""
