//! Latin hypercube: each parameter's range in as many strata as there are samples, one sample in each.

use supertwin_core::random::Stream;

/// Where in its range, from 0 to 1, each sample has the parameter `name`: `(π(i) + u)/n` with a random permutation π.
///
/// A stream per parameter: another parameter in the file, or another order, changes nothing for this one.
pub(super) fn strata(seed: u64, name: &str, samples: usize) -> impl Iterator<Item = f64> {
    let mut stream = Stream::new(seed, &format!("sweep {name}"));
    let mut order: Vec<usize> = (0..samples).collect();
    // Fisher and Yates.
    for i in (1..samples).rev() {
        let other = stream.below(u32::try_from(i + 1).unwrap_or(u32::MAX));
        order.swap(i, other as usize);
    }
    order.into_iter().map(move |stratum| (stratum as f64 + stream.uniform(0.0, 1.0)) / samples as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_stratum_has_one_sample_and_no_two_parameters_share_an_order() {
        let n = 200;
        let [mass, drag] = ["mass", "drag"].map(|name| strata(7, name, n).collect::<Vec<f64>>());
        for values in [&mass, &drag] {
            let mut strata: Vec<usize> = values.iter().map(|x| (x * n as f64) as usize).collect();
            strata.sort_unstable();
            assert_eq!(strata, (0..n).collect::<Vec<_>>());
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / n as f64;
        assert!((mean(&mass) - 0.5).abs() < 0.005, "{}", mean(&mass));
        let covariance: f64 = mass.iter().zip(&drag).map(|(a, b)| (a - 0.5) * (b - 0.5)).sum::<f64>() / n as f64;
        // Independent orders: a standard deviation of 1/12/√200 = 0.006.
        assert!(covariance.abs() < 0.025, "{covariance}");
        assert_eq!(strata(7, "mass", n).collect::<Vec<_>>(), mass, "the same seed, the same samples");
        assert_ne!(strata(8, "mass", n).collect::<Vec<_>>(), mass);
    }
}
