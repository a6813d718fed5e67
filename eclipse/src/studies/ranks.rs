//! How two quantities rise together, however their relation bends.

/// Spearman's correlation: of ranks, equal values sharing their mean rank.
///
/// No number where any value is none.
pub(super) fn rank_correlation(points: &[[f64; 2]]) -> f64 {
    if points.iter().flatten().any(|value| value.is_nan()) {
        return f64::NAN;
    }
    let ranks = [0, 1].map(|axis| {
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by(|&a, &b| points[a][axis].total_cmp(&points[b][axis]));
        let mut ranks = vec![0.0; points.len()];
        let mut start = 0;
        while start < order.len() {
            let value = points[order[start]][axis];
            let same = order[start..]
                .iter()
                .take_while(|&&i| points[i][axis] == value)
                .count();
            for &i in &order[start..start + same] {
                ranks[i] = start as f64 + 0.5 * (same - 1) as f64;
            }
            start += same;
        }
        ranks
    });
    let mean = 0.5 * (points.len() as f64 - 1.0);
    let product = |a: &[f64], b: &[f64]| -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - mean) * (b - mean)).sum()
    };
    let [x, y] = &ranks;
    product(x, y) / (product(x, x) * product(y, y)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_do_not_mind_how_a_relation_bends() {
        let falling: Vec<[f64; 2]> = (1..50)
            .map(|i| [f64::from(i), (-f64::from(i)).exp()])
            .collect();
        assert!((rank_correlation(&falling) + 1.0).abs() < 1e-12);
        let bent = [[1.0, 1.0], [2.0, 4.0], [2.0, 4.0], [3.0, 9.0]];
        assert!((rank_correlation(&bent) - 1.0).abs() < 1e-12);
        // Known by hand: ranks 0 1 2 3 against 1 0 3 2.
        let mixed = [[1.0, 2.0], [2.0, 1.0], [3.0, 4.0], [4.0, 3.0]];
        assert!((rank_correlation(&mixed) - 0.6).abs() < 1e-12);
    }
    #[test]
    fn what_is_no_number_has_no_rank() {
        let broken = [[1.0, 2.0], [f64::NAN, 1.0], [3.0, f64::NAN]];
        assert!(rank_correlation(&broken).is_nan());
    }
}
