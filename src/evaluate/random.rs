//! Random streams: each life of each row has its own, so that results do not depend on the order of the lives.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// The random stream of life `trial` of row `row`; `domain`: kind of run; `seed`: that of the run.
pub(super) fn stream(seed: u64, domain: u64, row: usize, trial: usize) -> ChaCha8Rng {
    let mut key = [0; 32];
    for (chunk, word) in key.chunks_exact_mut(8).zip([seed, domain, row as u64, trial as u64]) {
        chunk.copy_from_slice(&word.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}

#[cfg(test)]
mod tests {
    use rand::RngExt as _;

    use super::*;

    #[test]
    fn streams_differ_in_every_part_of_their_key_and_repeat() {
        let first = |seed, domain, row, trial| stream(seed, domain, row, trial).random::<u64>();
        let base = first(1, 2, 3, 4);
        assert_eq!(base, first(1, 2, 3, 4));
        for other in [first(2, 2, 3, 4), first(1, 3, 3, 4), first(1, 2, 4, 4), first(1, 2, 3, 5)] {
            assert_ne!(base, other);
        }
    }
}
