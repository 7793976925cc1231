//! Replays the committed corpus of a fuzz target, as it is and damaged a little in ways that are the same every time.

use std::fs;
use std::path::Path;

/// Calls `check` with every file of the corpus, with each cut short, and with bytes changed.
///
/// `folder` is the crate's own; at least `least` files must be there.
pub fn assert_for_corpus(folder: &str, target: &str, least: usize, variants: usize, check: impl Fn(&[u8])) {
    let corpus = Path::new(folder).join("fuzz/corpus").join(target);
    let mut paths: Vec<_> =
        fs::read_dir(&corpus).expect("a corpus").map(|entry| entry.expect("a file").path()).collect();
    paths.sort();
    assert!(paths.len() >= least, "{}: only {} files", corpus.display(), paths.len());
    let mut state = 1;
    for path in paths {
        let payload = fs::read(&path).expect("a file");
        check(&payload);
        for _ in 0..variants {
            let mut changed = payload.clone();
            let at = splitmix64(&mut state) as usize % changed.len().max(1);
            match splitmix64(&mut state) % 4 {
                0 => changed.truncate(at),
                1 => drop(changed.drain(at..(at + 9).min(payload.len()))),
                2 => changed.splice(at..at, payload.iter().copied().take(at).skip(at / 2)).for_each(drop),
                _ => changed.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << (state >> 61)),
            }
            check(&changed);
        }
    }
}

/// The next number of a generator whose state this is.
pub fn splitmix64(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let z = (*state ^ (*state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}
