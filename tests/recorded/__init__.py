import tests.any_processor
