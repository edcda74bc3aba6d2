"""learner_process"""
