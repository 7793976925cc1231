//! How a score follows a parameter over many runs.

/// Spearman's rank correlation: Pearson's of the ranks, where equal values share the mean of their ranks.
///
/// +1: whenever x grows, y does; −1: it shrinks. `None` with fewer than three points, or when one of the two is constant.
#[must_use]
pub fn rank_correlation(points: &[(f64, f64)]) -> Option<f64> {
    if points.len() < 3 {
        return None;
    }
    let x = ranks(&points.iter().map(|point| point.0).collect::<Vec<_>>());
    let y = ranks(&points.iter().map(|point| point.1).collect::<Vec<_>>());
    // The mean of all ranks, whatever is equal.
    let mean = 0.5 * (points.len() + 1) as f64;
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>();
    let scale = libm::sqrt(product(&x, &x) * product(&y, &y));
    (scale > 0.0).then(|| product(&x, &y) / scale)
}

/// Ranks from 1.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    for tied in order.chunk_by(|a, b| values[*a] == values[*b]) {
        // Ranks before these are taken by what is less.
        let before = order.partition_point(|i| values[*i].total_cmp(&values[tied[0]]).is_lt());
        let shared = before as f64 + 0.5 * (tied.len() + 1) as f64;
        tied.iter().for_each(|i| ranks[*i] = shared);
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_follow_the_order_and_nothing_else() {
        let curve: Vec<(f64, f64)> = (0..10).map(|i| (f64::from(i), f64::from(i * i * i))).collect();
        assert_eq!(rank_correlation(&curve), Some(1.0));
        let down: Vec<(f64, f64)> = curve.iter().map(|(x, y)| (*x, -y)).collect();
        assert_eq!(rank_correlation(&down), Some(-1.0));
        assert_eq!(ranks(&[5.0, 1.0, 5.0, 0.0]), [3.5, 2.0, 3.5, 1.0]);
        // scipy.stats.spearmanr([1, 2, 3, 4, 5], [5, 6, 7, 8, 7]).statistic
        let points = [(1.0, 5.0), (2.0, 6.0), (3.0, 7.0), (4.0, 8.0), (5.0, 7.0)];
        let correlation = rank_correlation(&points).expect("varies");
        assert!((correlation - 0.820_782_681_668_123_2).abs() < 1e-12, "{correlation}");
        assert_eq!(rank_correlation(&[(1.0, 2.0), (2.0, 2.0), (3.0, 2.0)]), None, "constant");
        assert_eq!(rank_correlation(&curve[..2]), None, "too few");
    }
}
