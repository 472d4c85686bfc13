//! What goes through shared memory: lives for one build, checked on connecting.
