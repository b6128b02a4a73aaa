"""The batches of games as environments of learning frameworks, one module a framework; each needs its extra."""
